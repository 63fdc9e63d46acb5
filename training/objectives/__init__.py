"""Losses, metrics and schedules."""
