"""Configurations of commands: `conf/`, the words of the command line, and the run of a policy."""
