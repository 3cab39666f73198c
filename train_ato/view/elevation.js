// Long train on the elevation profile: vehicles coloured by coupler force, planned brake applications ahead.
window.elevation = {
  draft: [255, 122, 89], buff: [74, 163, 255], slack: [125, 135, 144],

  // Elevation [m] at a place [m] from the steps of the grade; level before the first one.
  at(grades, place) {
    let low = 0, high = grades.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (grades[middle][0] <= place) low = middle + 1; else high = middle;
    }
    if (!low) return grades.length ? grades[0][2] : 0;
    const [begin, grade, height] = grades[low - 1];
    return height + (place - begin) * grade / 1000;
  },
  // Colour of a coupler force [kN]: draft or buff, stronger with the part of the reach of the force axis.
  colour(force, reach) {
    const part = Math.min(1, Math.sqrt(Math.abs(force) / reach)), end = force > 0 ? this.draft : this.buff;
    return `rgb(${this.slack.map((from, index) => Math.round(from + part * (end[index] - from))).join()})`;
  },
  draw(dmi) {
    const found = dmi.pane("elevation"), plot = Bokeh.documents[0] && Bokeh.documents[0].get_model_by_name("ahead");
    if (!found || !plot || !plot.inner_width) return;
    const {pen, width, height} = found, {line, row} = dmi, front = row.front_m[0];
    const left = width - plot.inner_width - 14, begin = plot.x_range.start * 1000, end = plot.x_range.end * 1000;
    const across = place => left + (place - begin) / (end - begin) * plot.inner_width;
    const knots = [begin, ...line.grades.map(step => step[0]).filter(place => place > begin && place < end), end];
    const heights = knots.map(place => this.at(line.grades, place));
    const lowest = Math.min(...heights), spread = Math.max(...heights) - lowest, shown = Math.max(spread, 4);
    const top = 30, low = height - 20;
    const up = metres => low - (low - top) * (metres - lowest + (shown - spread) / 2) / shown;
    pen.save();
    pen.beginPath();
    pen.rect(left, 0, plot.inner_width, height);
    pen.clip();
    this.drawBrakings(pen, dmi, across, front, begin, end, height);
    this.drawGround(pen, dmi, knots, heights, across, up, height);
    this.drawTrain(pen, dmi, across, up, front, row.coupler_reach ? row.coupler_reach[0] : 100);
    for (const place of line.stops) if (place > begin && place < end) {
      pen.fillStyle = dmi.colour.stop;
      pen.fillRect(across(place) - 1, 0, 3, height);
    }
    pen.restore();
    pen.fillStyle = dmi.colour.soft;
    pen.textAlign = "right";
    pen.fillText(`${spread.toFixed(spread < 9.5 ? 1 : 0)} m`, left - 6, (top + low) / 2);
    pen.fillText("height", left - 6, (top + low) / 2 - 14);
    this.drawAxis(pen, dmi, across, begin, end, height);
  },
  drawGround(pen, dmi, knots, heights, across, up, height) {
    pen.beginPath();
    pen.moveTo(across(knots[0]), height);
    knots.forEach((place, index) => pen.lineTo(across(place), up(heights[index])));
    pen.lineTo(across(knots[knots.length - 1]), height);
    pen.fillStyle = "#1d2b36";
    pen.fill();
    pen.beginPath();
    knots.forEach((place, index) => pen.lineTo(across(place), up(heights[index])));
    pen.strokeStyle = dmi.colour.rail;
    pen.lineWidth = 1.5;
    pen.stroke();
    pen.fillStyle = dmi.colour.soft;
    pen.textAlign = "center";
    for (let index = 0; index + 1 < knots.length; index++) {
      const width = across(knots[index + 1]) - across(knots[index]);
      const grade = 1000 * (heights[index + 1] - heights[index]) / (knots[index + 1] - knots[index]);
      const middle = (knots[index] + knots[index + 1]) / 2, level = (up(heights[index]) + up(heights[index + 1])) / 2;
      if (width > 44) pen.fillText(`${grade > 0.05 ? "+" : ""}${grade.toFixed(1)} ‰`, across(middle), Math.min(level + 14, height - 26));
    }
  },
  drawBrakings(pen, dmi, across, front, begin, end, height) {
    for (const [from, to] of dmi.line.brakings) {
      if (to <= Math.max(front, begin) || from >= end) continue;
      const x = across(Math.max(from, front)), width = Math.max(across(to) - x, 2);
      pen.fillStyle = "rgba(230, 159, 0, .16)";
      pen.fillRect(x, 0, width, height);
      pen.fillStyle = dmi.colour.brake;
      pen.fillRect(x, 0, width, 4);
      pen.textAlign = "left";
      if (width > 40) pen.fillText("brake", x + 3, 12);
    }
  },
  drawTrain(pen, dmi, across, up, front, reach) {
    const {rear, grades, length} = dmi.line, forces = dmi.forces && dmi.forces.data.coupler;
    if (!rear.length || !forces) return;
    pen.lineWidth = 7;
    rear.forEach((behind, index) => {
      const ahead = index ? (rear[index - 1] + behind) / 2 : 0;
      const after = index + 1 < rear.length ? (rear[index + 1] + behind) / 2 : length[0];
      pen.strokeStyle = this.colour(forces[index], reach);
      pen.beginPath();
      for (const back of [ahead, after]) pen.lineTo(across(front - back), up(this.at(grades, front - back)) - 5);
      pen.stroke();
    });
    pen.fillStyle = dmi.colour.text;
    pen.fillRect(across(front) - 1, up(this.at(grades, front)) - 12, 3, 12);
  },
  drawAxis(pen, dmi, across, begin, end, height) {
    const step = [100, 200, 500, 1000, 2000, 5000].find(size => (end - begin) / size <= 7) || 10000;
    pen.fillStyle = dmi.colour.soft;
    pen.textAlign = "right";
    pen.fillText("km", across(begin) - 6, height - 7);
    pen.textAlign = "center";
    for (let place = Math.ceil(begin / step) * step; place <= end; place += step)
      pen.fillText(place / 1000, across(place), height - 7);
  },
};
