"""Parts of the law ``mpc`` alone: its motion observer, forecast, force plan and deviations of units."""
