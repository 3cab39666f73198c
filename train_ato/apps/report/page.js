// What the bar under the title says of the moment under the cursor.
window.trainAto = (() => {
  const bar = document.querySelector(".readings");
  if (!bar) return { tell: () => undefined };
  const hours = bar.dataset.hours === "1", moment = bar.querySelector(".moment");
  const cells = [...bar.querySelectorAll(".reading b")];
  const two = (n) => String(n).padStart(2, "0");
  const clock = (time) => {
    const all = Math.abs(Math.round(10 * time)) / 10, sign = time < 0 ? "-" : "";
    const h = Math.floor(all / 3600), m = Math.floor(all / 60) % 60, s = (all - 60 * Math.floor(all / 60)).toFixed(1);
    return sign + (hours ? h + ":" + two(m) : String(60 * h + m)) + ":" + s.padStart(4, "0");
  };
  return {
    tell: (time, values) => {
      moment.textContent = "at " + clock(time);
      values.forEach((text, index) => { if (cells[index]) cells[index].textContent = text.replace("-", "−"); });
    },
  };
})();
