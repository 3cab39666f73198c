"""The parts of the closed loop, free of ROS: what the engine calls in turn and what the nodes wrap.

One tick: the plant measures at t_k; the profile and the observer answer; the controller sends a command stamped t_k;
the plant pushes it into its link and integrates to t_k+1 with the value due at each of its steps.
"""
