"""What everything else stands on: checks, files, verdicts, exit codes."""
