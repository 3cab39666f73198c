"""Stages of the closed loop, free of ROS, used by the engine and by the nodes.

One tick has four steps. The plant measures at t_k. The profile and the observer answer. The controller sends a command
stamped t_k. The plant adds it to its link and integrates to t_k+1 with the value that has arrived at each step. Every
few ticks there is a step of the supervisor: the plant also sends its odometry, and the supervisor answers with the
brake release.

Most ticks of a run have no event. A span (``span.py``) runs many of them in one compiled call and makes their messages
from its arrays, bit for bit. Every tick with an event (a change of the brake pipe, a jump, a change of the law,
standstill, an impossible value) is left to the stages in Python.
"""
