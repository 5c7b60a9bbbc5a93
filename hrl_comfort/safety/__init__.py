"""Between a policy and the arm: the arm's rating, and a shield for the person beside it."""
