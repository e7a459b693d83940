"""Files of a project: how they are found (`locate`), read (`toml`) and written (`folders`)."""
