"""The bench in the browser: a page on this machine alone that runs the commands of the command line in one folder, a session."""
