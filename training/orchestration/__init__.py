"""Automatic training in rounds, on one machine or on Ray."""
