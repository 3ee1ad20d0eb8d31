"""What chunks were, written down. `python -m tests.golden` writes it anew; the diff is for a reader to judge.

`chunks.txt` has a line for each of some chunks of the built-in worlds, with counts and a digest of each array: which of
them change says what has changed. `octant.txt` is one small mesh in full. The numbers hold on any machine.
"""
