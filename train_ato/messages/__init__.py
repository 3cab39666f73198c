"""Topics and their messages: the topic table, message types, delay lines and the codec; free of ROS."""
