"""Configurations from `conf/`, from the command line and from run folders."""
