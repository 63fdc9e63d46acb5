"""Tracks of balls in footage of a camera that stands still (extra ``track``).

A clip's way: what the picture looks like without balls (``background``), round things in front of
it (``detection``), which of them follow each other and are one ball (``tracklets``, ``identity``),
smoothed positions (``smoothing``), rows of a table (``tracks``), what to doubt of them
(``quality``) and a film to look at (``overlay``). Decision 0128.
"""
