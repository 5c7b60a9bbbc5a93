"""Learners of tops: what a network scores, and how it learns."""
