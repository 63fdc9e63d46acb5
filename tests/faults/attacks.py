"""What attacks do to good requests: their times, the memory, and how long a stop takes.

Times are compared with those of the same service a moment before, so that what else the machine
does counts in both; the median of some rounds is told.
"""

ROUNDS = 5
ROUND_S = 4.0
MOST_TIMES = 3.0
MOST_GROWTH = 1.05
STOP_MARGIN_S = 3
SETTLED_S = 10
