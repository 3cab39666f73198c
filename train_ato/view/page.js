// Moves the ranges in view with the train: places of the figures ahead, times of the strip charts.
const kilometres = views[view.active], seconds = windows[window_.active];
const place = where.data.place[0], time = where.data.time[0];
place_range.setv({start: place - 0.16 * kilometres, end: place + 0.84 * kilometres});
const ahead = live ? 0.02 * seconds : 0.25 * seconds;
const end = Math.max(time + ahead, seconds * (live ? 1 : 0.6));
span.setv({start: end - seconds, end: end});
window.overview.time = time;
window.dmi.draw();
