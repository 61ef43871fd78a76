"""A recording as a pandas table, as an xarray dataset and as a picture."""

# %%
import tempfile
from pathlib import Path

import truestroke
from truestroke import plant, trajectories

wave = trajectories.sine(frequency=5.0, peak_to_peak=20.0, duration=1.0)
controller = truestroke.AdaptiveController(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
recording = truestroke.run(wave, controller, plant.RealisticPlant(seed=0))

# %%
table = recording.to_dataframe()
print(table.loc[0.5:, ["desired", "measured"]].describe().loc[["min", "max"]].round(1).to_string())
print(dict(recording.to_xarray()["weights"].sizes))

# %%
with tempfile.TemporaryDirectory() as folder:
    recording.save(Path(folder) / "run.h5")
    same = truestroke.Recording.load(Path(folder) / "run.h5")
    figure = same.plot()
    figure.savefig(Path(folder) / "run.png")
    print((Path(folder) / "run.png").stat().st_size > 10_000)

# %% [markdown]
# Prints:
#
#          desired  measured
#     min      0.0      -0.0
#     max     20.0      20.0
#     {'weights_time': 100, 'weights_index': 41}
#     True
