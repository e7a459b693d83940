"""Files of a project: how they are found (`locate`), read (`load`) and written (`atomic_write`)."""
