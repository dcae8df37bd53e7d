"""The command line interface of armcell; each command has its own file."""
