"""Railway simulation without ROS: trains, lines, draft gears, brakes and the compiled integration."""
