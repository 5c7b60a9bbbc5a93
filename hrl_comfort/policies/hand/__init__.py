"""The expert with a hand that holds: its goal postures, what a way beside people takes, and its grasps."""
