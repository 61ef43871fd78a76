"""A simulated XY stage that images a grating and a texture: open loop, with the paper's law, with truestroke."""
