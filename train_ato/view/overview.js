// Overview of the run: speed over its whole time, marks of events, bands of law and ATO state. A click shows that time.
window.overview = {
  left: 62, right: 14, found: null, time: 0,
  hues: ["#2b5a7d", "#5a3f7d", "#2f6d5c", "#7d5a2b", "#7d3f5a"],
  states: {"engaged": "#1f6b4f", "failure": "#8a1f1a", "disengaging": "#7a5a12"},

  take(found) {
    this.found = found;
    this.draw();
  },
  across(time, width) {
    const [begin, end] = this.found.span;
    return this.left + (width - this.left - this.right) * (time - begin) / Math.max(end - begin, 1e-9);
  },
  draw() {
    const pane = this.found && window.dmi.pane("overview");
    if (!pane) return;
    const {pen, width, height} = pane, {colour} = window.dmi, low = height - 30;
    this.drawSpeed(pen, width, low, colour);
    this.drawBand(pen, width, low + 2, this.found.law, "law", index => this.hues[index % this.hues.length]);
    this.drawBand(pen, width, low + 16, this.found.ato, "ATO", (index, text) =>
      this.states[text] || (text.startsWith("engaged") ? "#7a5a12" : "#39424a"));
    for (const [time, , urgent] of this.found.marks) {
      pen.fillStyle = urgent ? colour.limit : "#d79bd0";
      pen.fillRect(this.across(time, width) - 1, 0, 2, low);
    }
    pen.fillStyle = colour.text;
    pen.fillRect(this.across(this.time, width) - 1, 0, 2, height);
  },
  drawSpeed(pen, width, low, colour) {
    const {points} = this.found, top = Math.max(10, ...points.map(point => Math.max(point[1], point[2] || 0))) * 1.05;
    const up = speed => low - (low - 2) * speed / top;
    pen.fillStyle = colour.soft;
    pen.textAlign = "right";
    pen.fillText(`${Math.round(top / 1.05)} km/h`, this.left - 6, 8);
    if (!points.length) return;
    pen.beginPath();
    pen.moveTo(this.across(points[0][0], width), low);
    for (const [time, speed] of points) pen.lineTo(this.across(time, width), up(speed));
    pen.lineTo(this.across(points[points.length - 1][0], width), low);
    pen.fillStyle = "#1f4a66";
    pen.fill();
    pen.fillStyle = colour.limit;
    points.forEach(([time, , limit], index) => {
      if (limit === null) return;
      const x = this.across(time, width), next = index + 1 < points.length ? points[index + 1][0] : time;
      pen.fillRect(x, up(limit) - 0.5, Math.max(1, this.across(next, width) - x), 1);
    });
  },
  // Parts of a band, each from its time to the next one, with its text where there is room.
  drawBand(pen, width, top, parts, name, colourOf) {
    const texts = [...new Set(parts.map(part => part[1]))];
    const last = this.found.points.length ? this.found.points[this.found.points.length - 1][0] : this.found.span[0];
    pen.textAlign = "right";
    pen.fillStyle = window.dmi.colour.soft;
    pen.fillText(name, this.left - 6, top + 6);
    pen.textAlign = "left";
    parts.forEach(([time, text], index) => {
      const x = this.across(time, width), end = this.across(index + 1 < parts.length ? parts[index + 1][0] : last, width);
      pen.fillStyle = colourOf(texts.indexOf(text), text);
      pen.fillRect(x, top, Math.max(1, end - x - 1), 12);
      pen.fillStyle = window.dmi.colour.text;
      if (pen.measureText(text).width + 8 < end - x) pen.fillText(text, x + 4, top + 6.5);
    });
  },
  timeAt(event) {
    const box = event.target.getBoundingClientRect(), [begin, end] = this.found.span;
    const part = (event.clientX - box.left - this.left) / (box.width - this.left - this.right);
    return begin + (end - begin) * Math.min(Math.max(part, 0), 1);
  },
  // A recorded run has a time slider; the place of a click is its new value.
  click(event) {
    const slider = this.found && Bokeh.documents[0].get_model_by_name("time");
    if (slider) slider.value = this.timeAt(event);
  },
  // The title of the picture names the event at the pointer, or else law and state.
  point(event) {
    if (!this.found) return;
    const time = this.timeAt(event), [begin, end] = this.found.span;
    const near = this.found.marks.filter(mark => Math.abs(mark[0] - time) < (end - begin) / 150).map(mark => mark[1]);
    const at = parts => (parts.filter(part => part[0] <= time).pop() || ["", ""])[1];
    event.target.title = near.join("\n") || [at(this.found.law), at(this.found.ato)].filter(text => text).join(", ");
  },
};
