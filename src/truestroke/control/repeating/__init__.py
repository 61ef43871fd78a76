"""What repeats is learned: from pass to pass, from batch to batch of a controller, and as strain of an axis."""
