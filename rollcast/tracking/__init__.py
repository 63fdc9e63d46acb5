"""Tracks of balls in footage of a fixed camera (extra ``track``).

Stages: the background without balls (``background``), round objects in front of it
(``detection``), tracklets and their assignment to balls (``tracklets``, ``association``), smoothed
positions (``smoothing``), tables (``tracks``), quality reports (``quality``) and videos for review
(``overlay``). Decision 0128.
"""
