// Distance bar, planning area, stop window and messages after ERA_ERTMS_015560, drawn on canvases: no figure is laid out
// again at a frame.  Places are those of the front of the train [m].
window.dmi = {
  line: null,   // grades, limits, stops, brakings, rear, length, window
  row: null,    // newest row of the driver's display
  forces: null, // coupler forces [kN], front first
  range: 8000,
  colour: {grid: "#24384b", soft: "#8da2b5", text: "#e6edf3", up: "#6f7a84", down: "#39424a", pasp: "#1d3f63",
    stop: "#ffd24a", brake: "#e69f00", limit: "#ff5f45", train: "#56b4e9", yellow: "#dfdf00", rail: "#aebccb"},

  // Part of the height for a distance: linear up to a fortieth of the range, logarithmic beyond (8.3.3).
  part(distance, range) {
    const first = range / 40, share = 0.125;
    if (distance <= first) return share * Math.max(distance, 0) / first;
    return share + (1 - share) * Math.log(Math.min(distance, range) / first) / Math.log(40);
  },
  // Canvas with its size in CSS pixels; null while it is not in sight. The observer reports the size, because reading it
  // at every frame computes the layout of the page again.
  sizes: new Map(),
  observer: new ResizeObserver(entries => {
    for (const {target, contentRect} of entries) window.dmi.sizes.set(target, contentRect);
    window.dmi.draw();
  }),
  pane(name) {
    const canvas = document.getElementById(name);
    if (canvas && !this.sizes.has(canvas)) {
      this.sizes.set(canvas, {width: 0, height: 0});
      this.observer.observe(canvas);
    }
    const {width, height} = this.sizes.get(canvas) || {};
    if (!width) return null;
    const scale = window.devicePixelRatio || 1;
    if (canvas.width !== Math.round(width * scale) || canvas.height !== Math.round(height * scale)) {
      canvas.width = Math.round(width * scale);
      canvas.height = Math.round(height * scale);
    }
    const pen = canvas.getContext("2d");
    pen.setTransform(scale, 0, 0, scale, 0, 0);
    pen.clearRect(0, 0, width, height);
    pen.font = "11px Arial, sans-serif";
    pen.textBaseline = "middle";
    return {pen, width, height};
  },
  say(metres) { return metres >= 999.5 ? `${(metres / 1000).toFixed(metres < 9995 ? 2 : 1)} km` : `${Math.round(metres)} m`; },

  take(row) {
    this.row = row;
    this.drawTarget();
    this.drawWindow();
  },
  takeLine(line) {
    this.line = line;
    const end = Math.max(...line.stops, ...line.limits.map(limit => limit[0]), 0) - (this.row ? this.row.front_m[0] : 0);
    if (!this.chosen) this.zoom([1000, 2000, 4000, 8000, 16000, 32000].find(range => range >= end) || 32000, false);
  },
  zoom(range, chosen = true) {
    this.range = range;
    this.chosen = chosen;
    for (const button of document.querySelectorAll("#planning_zoom button"))
      button.classList.toggle("on", Number(button.value) === range);
    this.draw();
  },
  draw() {
    window.overview.draw();
    if (!this.line || !this.row || !this.row.front_m) return;
    this.drawTarget();
    this.drawWindow();
    this.drawPlanning();
    if (window.elevation) window.elevation.draw(this);
  },

  // Distance to the target, 0 to 1000 m on the logarithmic scale of 8.2.2.
  drawTarget() {
    const found = this.pane("target"), row = this.row;
    if (!found || !row.target_m) return;
    const {pen, width, height} = found, colour = this.colour, top = 22, low = height - 6, metres = row.target_m[0];
    const level = distance => low - (low - top) * this.part(distance, 1000);
    pen.textAlign = "left";
    for (const distance of [0, 25, 50, 100, 250, 500, 1000]) {
      pen.fillStyle = colour.soft;
      pen.fillRect(0, level(distance), distance % 500 ? 8 : 14, 1);
      if (distance >= 100) pen.fillText(distance, 0, level(distance) + 8);
    }
    const known = Number.isFinite(metres);
    pen.fillStyle = colour.text;
    pen.font = "bold 12px Arial, sans-serif";
    pen.textAlign = "right";
    pen.fillText(known ? this.say(metres) : "–", width, 8);
    if (known) {
      pen.fillStyle = row.guidance[0] === "normal" ? colour.soft : row.needle[0];
      pen.fillRect(width - 14, level(metres), 14, low - level(metres));
    }
  },
  // Stop window: the last metres on a linear scale of four windows to each side.
  drawWindow() {
    const place = document.getElementById("stopping"), row = this.row;
    const near = this.line && row.stop_offset && Math.abs(row.stop_offset[0]) < 20;
    if (place) place.hidden = !near;
    const found = near && this.pane("window");
    if (!found) return;
    const {pen, width, height} = found, half = this.line.window[0], reach = 4 * half, offset = row.stop_offset[0];
    const at = metres => width * (0.5 + 0.5 * Math.max(-1, Math.min(1, metres / reach)));
    pen.fillStyle = this.colour.grid;
    pen.fillRect(0, height / 2 - 1, width, 2);
    pen.fillStyle = Math.abs(offset) <= half ? "#1f8f5f" : "#3a4a58";
    pen.fillRect(at(-half), 2, at(half) - at(-half), height - 4);
    pen.fillStyle = this.colour.stop;
    pen.fillRect(at(0) - 1, 0, 2, height);
    pen.fillStyle = this.colour.train;
    pen.fillRect(at(offset) - 2, 1, 4, height - 2);
  },

  drawPlanning() {
    const found = this.pane("planning");
    if (!found) return;
    const {pen, width, height} = found, line = this.line, colour = this.colour, front = this.row.front_m[0];
    const top = 12, low = height - 8, range = this.range, level = metres => low - (low - top) * this.part(metres, range);
    const left = 46, gradient = [left + 46, 24], pasp = gradient[0] + gradient[1] + 8;
    this.drawSpeeds(pen, pasp, width, front, range, level);
    this.drawGrades(pen, gradient, front, range, level);
    pen.textAlign = "right";
    for (const share of [0, 1 / 40, 1 / 20, 1 / 10, 1 / 8, 1 / 4, 1 / 2, 1]) {
      const metres = range * share, strong = share === 0 || share >= 0.5 || share === 1 / 4 || share === 1 / 8;
      pen.fillStyle = strong ? colour.soft : colour.grid;
      pen.fillRect(left, level(metres), width - left, 1);
      pen.fillStyle = colour.soft;
      if (strong) pen.fillText(share ? metres : "0 m", left - 6, level(metres));
    }
    pen.fillText("‰", gradient[0] + gradient[1] - 6, 5);
    pen.fillText("km/h", width, 5);
    this.drawPoints(pen, left, pasp, width, front, range, level);
  },
  // Most restrictive speeds: a block up to the next lower limit, narrower for lower speeds (8.3.7).
  drawSpeeds(pen, from, width, front, range, level) {
    const limits = this.line.limits, present = limits.findLastIndex(limit => limit[0] <= front);
    const ahead = limits.filter(limit => limit[0] > front && limit[0] < front + range);
    let speed = present < 0 ? NaN : limits[present][1], lowest = speed, parts = 4, begin = 0;
    for (const [place, next] of [...ahead, [front + range, NaN]]) {
      pen.fillStyle = this.colour.pasp;
      const top = level(place - front);
      pen.fillRect(from, top, (width - from) * parts / 4, level(begin) - top);
      begin = place - front;
      if (next < lowest) { lowest = next; parts = Math.max(1, parts - 1); }
    }
    pen.textAlign = "left";
    for (const [place, next] of ahead) {
      const height = level(place - front);
      pen.fillStyle = next < speed ? this.colour.limit : this.colour.soft;
      pen.fillText(`${next < speed ? "▼" : "▲"} ${Math.round(next)}`, from + 4, height - 7);
      pen.fillRect(from, height, width - from, 1);
      speed = next;
    }
  },
  drawGrades(pen, [x, width], front, range, level) {
    const grades = this.line.grades;
    pen.textAlign = "center";
    grades.forEach(([place, grade], number) => {
      const end = number + 1 < grades.length ? grades[number + 1][0] : Infinity;
      if (end <= front || place >= front + range) return;
      const low = level(Math.max(place - front, 0)), top = level(Math.min(end - front, range));
      pen.fillStyle = grade >= 0 ? this.colour.up : this.colour.down;
      pen.fillRect(x, top, width, Math.max(low - top - 1, 1));
      if (low - top < 13) return;
      pen.fillStyle = "#fff";
      pen.fillText(`${grade >= 0 ? "+" : "−"}${Math.abs(grade).toFixed(1).replace(".0", "")}`, x + width / 2, (low + top) / 2);
    });
  },
  // Begin of the planned brake applications, stops, and the target of the supervision.
  drawPoints(pen, left, pasp, width, front, range, level) {
    const inside = place => place > front && place < front + range;
    let free = Infinity;  // the next word has its place below this height
    pen.textAlign = "left";
    for (const [begin, end] of this.line.brakings) {
      if (end <= front || begin >= front + range) continue;
      const top = level(Math.min(end - front, range)), low = level(Math.max(begin - front, 0));
      pen.fillStyle = this.colour.brake;
      pen.fillRect(left + 34, top, 5, Math.max(low - top, 2));
      if (!inside(begin) || low > free) continue;
      pen.fillText("brake", left + 2, low - 1);
      free = low - 11;
    }
    for (const place of this.line.stops) if (inside(place)) {
      pen.fillStyle = this.colour.stop;
      pen.fillRect(left, level(place - front) - 1, width - left, 3);
      pen.fillText("STOP", width - 34, level(place - front) + 9);
    }
    const target = this.row.target_m[0];
    if (this.row.guidance[0] !== "normal" && target > 0 && target < range) {
      pen.fillStyle = this.colour.yellow;
      pen.fillRect(pasp, level(target) - 1, width - pasp, 2);
    }
  },

  // Text messages, newest first; the first one that waits is acknowledged by a click on it (8.2.3.4).
  showMessages(data, acknowledgement) {
    const list = document.getElementById("messages");
    list.replaceChildren(...data.text.map((text, place) => {
      const entry = document.createElement(data.waiting[place] ? "button" : "div");
      entry.className = data.waiting[place] ? "waiting" : "";
      entry.title = data.waiting[place] ? "click to acknowledge" : "";
      entry.textContent = `${data.clock[place]}  ${text}`;
      if (data.waiting[place]) entry.onclick = () => { acknowledgement.number = data.number[place]; };
      return entry;
    }));
  },
};
