"""The railway: trains, lines, draft gears, brakes and the compiled step that moves them; knows no ROS."""
