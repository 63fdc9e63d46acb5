"""The training loop, the total loss and initial weights."""
