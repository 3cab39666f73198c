// Follows the row of the moment: texts, and what of place and time is in view. Runs in the browser at every frame.
const row = now.data;
const kilometres = views[view.active], seconds = windows[window_.active];
const place = row.place[0], time = row.time[0];
place_range.setv({start: place - 0.16 * kilometres, end: place + 0.84 * kilometres});
const ahead = live ? 0.02 * seconds : 0.25 * seconds;
const end = Math.max(time + ahead, seconds * (live ? 1 : 0.6));
span.setv({start: end - seconds, end: end});
if (row.coupler_reach && reach.end != row.coupler_reach[0])
  reach.setv({start: -row.coupler_reach[0], end: row.coupler_reach[0]});
if (row.shoe_reach && shoes.end != row.shoe_reach[0])
  shoes.setv({end: row.shoe_reach[0]});
window.trainAto.show(row);
if (row.number) requestAnimationFrame(() => { drawn.number = row.number[0]; });
