"""What can be taken away of a recording: its shape, its picture, its course."""
