"""Onboard automatic train operation as a ROS 2 node graph: profiles, observers, laws, links, log."""
