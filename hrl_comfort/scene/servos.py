"""Position servos of the arms."""

SERVO_LAG_S = 0.03
"""Damping over stiffness, the lag behind a ramp; more where an arm needs it to be damped critically."""
