"""What runs: the loop, batches, drivers, real time, the first volts."""
