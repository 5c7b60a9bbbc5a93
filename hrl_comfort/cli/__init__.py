"""The command line around the commands: their table, help and completion."""
