"""The base of all other packages: checks, files, verdicts, exit codes."""
