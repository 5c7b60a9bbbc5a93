"""Train, evaluate, report: what the commands do."""
