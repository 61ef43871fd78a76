"""What the measured gain of an axis may be, um/V: the bounds of commissioning and of the check before each run."""

COMMISSIONING = (0.2, 4.0)
"""Of stroke over voltage range: small steps, before anything is known but these two."""

RUN = (1 / 8.0, 4.5)
"""Of the lesser, and of the greater, of stroke over voltage range and the gain that the controller starts with.

Wider, so that an axis that was commissioned passes, also when it is older, colder, or driven by smaller steps.
"""
