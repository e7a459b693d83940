"""Plans of insertions: targets and obstacles (`goals`), and how to steer past them (`steering`)."""
