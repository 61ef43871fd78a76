"""How many plays does a stack need? Grid search of scikit-learn over identified models."""

# %%
import numpy as np
from sklearn.model_selection import GridSearchCV, TimeSeriesSplit

from truestroke import plant
from truestroke.identification.adapters.sklearn import ActuatorRegressor

time = np.arange(6000) / 2000.0  # s
volts = 1.5 - 1.5 * np.cos(2 * np.pi * time) * np.cos(0.9 * time)
z = plant.RealisticPlant(seed=0).exchange(volts)

# %%
stage = ActuatorRegressor(2000.0, continued=True, rate=False, creep_times=(), asymmetry=1, delay=0.0)
grid = {"thresholds": [tuple(np.arange(plays) * 1.6 / plays) for plays in (1, 4, 8)]}  # V
search = GridSearchCV(stage, grid, cv=TimeSeriesSplit(2, test_size=1500)).fit(volts[:, np.newaxis], z)
for thresholds, score in zip(grid["thresholds"], search.cv_results_["mean_test_score"], strict=True):
    print(f"{len(thresholds)} plays: R^2 = {score:.4f}")

# %% [markdown]
# Prints:
#
#     1 plays: R^2 = 0.9128
#     4 plays: R^2 = 0.9919
#     8 plays: R^2 = 0.9988
