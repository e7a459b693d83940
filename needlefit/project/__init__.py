"""Where a project's files lie (`places`), and how a TOML file becomes a checked record (`load`)."""
