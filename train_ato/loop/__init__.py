"""Stages of the closed loop, free of ROS, used by the engine and by the nodes.

One tick: the plant measures at t_k; the profile and the observer answer; the controller sends a command stamped t_k;
the plant adds it to its link and integrates to t_k+1 with the value that has arrived at each step.  At a step of the
supervisor, every few ticks, the plant also sends its odometry, and the supervisor answers with the brake release.

Most ticks of a run have no event. A span (``span.py``) runs many of them in one compiled call and makes their messages
from its arrays, bit for bit. Every tick with an event (a change of the brake pipe, a jump, a change of the law,
standstill, an impossible value) is left to the stages in Python.
"""
