"""Offline part of Rollcast: data sets, networks, training, evaluation, export. Never served."""
