"""What the prediction error of a model contains, and whether the model is to be used."""
