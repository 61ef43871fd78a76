"""Many runs and what they show: comparison, paper, robustness, characterisation."""
