"""Replay of a recorded run on ROS topics, controlled by services, and of a law on recorded inputs."""
