"""Spoiling the safety side on purpose: a test suite is worth what it notices. `python -m tests.hw.spoil --help`.

A spoiling is one small change of the firmware or of the host's side of the line that makes it wrong: a dangerous slip that a person might
make (byhand.py), or one of the usual slips of the pen, drawn by a seed from the source as it is (operators.py). Each is made in a copy, on
which the tests run until the first one fails. What no test fails on has survived: a test is missing, or the change changes nothing
(equivalent.py says why, one by one).
"""
