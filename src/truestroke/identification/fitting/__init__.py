"""From samples to a model: regression, choice of the structure, dead time, stage, uncertainty."""
