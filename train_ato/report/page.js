// Values at the cursor, colours of a dark screen and sizes of a narrow one.
window.trainAto = (() => {
  const bar = document.querySelector(".readings");
  const hours = bar?.dataset.hours === "1", moment = bar?.querySelector(".moment");
  const cells = bar ? [...bar.querySelectorAll(".reading b")] : [];
  const two = (n) => String(n).padStart(2, "0");
  const clock = (time) => {
    const all = Math.abs(Math.round(10 * time)) / 10, sign = time < 0 ? "-" : "";
    const h = Math.floor(all / 3600), m = Math.floor(all / 60) % 60, s = (all - 60 * Math.floor(all / 60)).toFixed(1);
    return sign + (hours ? h + ":" + two(m) : String(60 * h + m)) + ":" + s.padStart(4, "0");
  };
  const show = (time, values) => {
    if (!moment) return;
    moment.textContent = "at " + clock(time);
    values.forEach((text, index) => { if (cells[index]) cells[index].textContent = text.replace("-", "−"); });
  };
  const nearest = (column, value, rising) => {
    let low = 0, high = column.length - 1;
    if (!rising) {
      for (let row = 1; row <= high; row++)
        if (Math.abs(column[row] - value) < Math.abs(column[low] - value)) low = row;
      return low;
    }
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (column[middle] <= value) low = middle; else high = middle;
    }
    return value - column[low] <= column[high] - value ? low : high;
  };
  const read = (fields, time) => {
    let place = null;
    const values = fields.map(([source, column, digits]) => {
      const value = source.data[column][nearest(source.data.time, time, true)];
      if (column === "position_km") place = value;
      return Number.isFinite(value) ? value.toFixed(digits) : "–";
    });
    show(time, values);
    return place;
  };
  const mark = (spans, location) => {
    for (const span of spans) { span.location = location; span.visible = location !== null; }
  };
  const overTime = (fields, places, time) => mark(places, read(fields, time));
  const overDistance = (fields, speed, times, place) => {
    const time = speed.data.time[nearest(speed.data.position_km, place, false)];
    read(fields, time);
    mark(times, time);
  };
  const readout = (name, tables, x, over) => {
    const line = document.getElementById("readout-" + name);
    if (!line) return;
    const parts = [];
    tables.forEach(([source, lines], index) => {
      const row = nearest(source.data[over], x, over === "time");
      const add = (words, text, unit, colour) => {
        const part = document.createElement("span"), value = document.createElement("b");
        value.textContent = text.replace("-", "−");
        if (colour) {
          const swatch = document.createElement("span");
          swatch.className = "swatch";
          swatch.style.background = dark.matches ? lighter(colour) : colour;
          part.append(swatch);
        }
        part.append(words + " ", value, unit ? " " + unit : "");
        parts.push(part);
      };
      if (index === 0) add("at", over === "time" ? clock(source.data.time[row]) : x.toFixed(3), over === "time" ? "" : "km");
      for (const [column, words, unit, digits, colour] of lines) {
        const value = source.data[column][row];
        if (Number.isFinite(value)) add(words, value.toFixed(digits), unit, colour);
      }
    });
    line.replaceChildren(...parts);
  };

  const dark = matchMedia("(prefers-color-scheme: dark)"), narrow = matchMedia("(max-width: 600px)");
  const toHsl = (hex) => {
    const [r, g, b] = [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16) / 255);
    const most = Math.max(r, g, b), least = Math.min(r, g, b), l = (most + least) / 2, d = most - least;
    if (d === 0) return [0, 0, l];
    const h = most === r ? ((g - b) / d + 6) % 6 : most === g ? (b - r) / d + 2 : (r - g) / d + 4;
    return [60 * h, d / (1 - Math.abs(2 * l - 1)), l];
  };
  const toHex = ([h, s, l]) => {
    const part = (n) => {
      const k = (n + h / 30) % 12;
      return Math.round(255 * (l - s * Math.min(l, 1 - l) * Math.max(-1, Math.min(k - 3, 9 - k, 1))));
    };
    return "#" + [0, 8, 4].map((n) => part(n).toString(16).padStart(2, "0")).join("");
  };
  const isHex = (colour) => typeof colour === "string" && /^#[0-9a-f]{6}$/i.test(colour);
  const lighter = (hex) => {
    if (!isHex(hex)) return hex;
    const [h, s, l] = toHsl(hex);
    return toHex([h, Math.min(s, 0.75), l < 0.3 && s < 0.4 ? 1 - 0.6 * l : Math.max(l, 0.6)]);
  };
  const inverted = (hex) => { const [h, s, l] = toHsl(hex); return toHex([h, s, 0.1 + 0.85 * (1 - l)]); };
  const before = new Map();
  const paint = (model, key, colour) => {
    if (!(key in model)) return;
    const id = model.id + "/" + key;
    if (!before.has(id)) before.set(id, model[key]);
    model[key] = dark.matches ? colour(before.get(id)) : before.get(id);
  };
  const glyphColour = (spec) => isHex(spec) ? lighter(spec) : isHex(spec?.value) ? { ...spec, value: lighter(spec.value) } : spec;
  const colours = (plot) => {
    const style = getComputedStyle(document.documentElement), of = (name) => () => style.getPropertyValue(name).trim();
    paint(plot, "background_fill_color", of("--paper"));
    const parts = [...plot.left, ...plot.right, ...plot.above, ...plot.below, ...plot.center];
    for (const part of parts) {
      for (const key of ["axis_label_text_color", "major_label_text_color", "label_text_color", "title_text_color"])
        paint(part, key, of("--ink"));
      for (const key of ["axis_line_color", "major_tick_line_color"]) paint(part, key, of("--soft"));
      paint(part, "grid_line_color", of("--faint"));
      if (part.type === "Legend") paint(part, "inactive_fill_color", of("--paper"));
      if (part.type === "ColorBar") paint(part.color_mapper, "palette", (all) => all.map(inverted));
      if (part.type === "Span") paint(part, "line_color", glyphColour);
    }
    for (const drawn of plot.renderers) {
      for (const glyph of [drawn.glyph, drawn.nonselection_glyph, drawn.selection_glyph, drawn.muted_glyph]) {
        if (!glyph?.properties) continue;
        for (const key of ["line_color", "fill_color", "text_color"]) paint(glyph, key, glyphColour);
        if (glyph.type === "Image") paint(glyph.color_mapper, "palette", (all) => all.map(inverted));
      }
    }
  };
  const sizes = (plot) => {
    const small = narrow.matches, wide = document.querySelector("main").clientWidth;
    const [left, right, height, columns] = plot.tags[0];
    plot.min_border_left = small ? 50 : left;
    plot.min_border_right = small ? 10 : right;
    plot.toolbar.visible = !small;
    let added = 0;
    for (const legend of plot.above.filter((part) => part.type === "Legend")) {
      const labels = legend.items.map((item) => item.label.value ?? "");
      const fit = Math.max(1, Math.floor((wide - 70) / (50 + 6.2 * Math.max(1, ...labels.map((text) => text.length)))));
      legend.ncols = small ? fit : columns;
      added += small ? 24 * (Math.ceil(labels.length / fit) - Math.ceil(labels.length / columns)) : 0;
    }
    for (const scale of plot.above.filter((part) => part.type === "ColorBar")) scale.width = small ? wide - 110 : 420;
    plot.height = height + added;
    if (matchMedia("(pointer: coarse)").matches)
      for (const tool of plot.toolbar.tools) if (tool.type === "BoxZoomTool") tool.active = false;
  };
  const swatches = () => {
    for (const swatch of document.querySelectorAll(".swatch[data-colour]"))
      swatch.style.background = dark.matches ? lighter(swatch.dataset.colour) : swatch.dataset.colour;
  };
  const dress = () => {
    for (const root of window.Bokeh?.documents[0]?.roots() ?? []) { colours(root); sizes(root); }
    swatches();
  };
  const start = () => { if (window.Bokeh?.documents.length) dress(); else requestAnimationFrame(start); };
  if (window.Bokeh) start();
  swatches();
  for (const query of [dark, narrow]) query.addEventListener("change", dress);
  return { overTime, overDistance, readout };
})();
