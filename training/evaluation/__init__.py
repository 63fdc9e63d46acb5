"""Evaluation on fixed scenes, error breakdown, comparison with the paper."""
