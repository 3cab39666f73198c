"""Compiled spans: ticks without events run in compiled code, with the same messages, bit for bit.

Most ticks of a run consist of sensors, law, delay line and train only. A span runs many of them in one compiled
call and makes their messages from its arrays. Every tick with an event (a change of the brake pipe, a jump, a change of
the law, standstill, an impossible value) is left to the stages in Python.
"""
