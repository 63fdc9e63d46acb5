"""Campaigns of trainings, on one machine or on Ray."""
