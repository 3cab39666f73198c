// Values at the cursor in the bar below the title.
window.trainAto = (() => {
  const bar = document.querySelector(".readings");
  if (!bar) return { show: () => undefined };
  const hours = bar.dataset.hours === "1", moment = bar.querySelector(".moment");
  const cells = [...bar.querySelectorAll(".reading b")];
  const two = (n) => String(n).padStart(2, "0");
  const clock = (time) => {
    const all = Math.abs(Math.round(10 * time)) / 10, sign = time < 0 ? "-" : "";
    const h = Math.floor(all / 3600), m = Math.floor(all / 60) % 60, s = (all - 60 * Math.floor(all / 60)).toFixed(1);
    return sign + (hours ? h + ":" + two(m) : String(60 * h + m)) + ":" + s.padStart(4, "0");
  };
  return {
    show: (time, values) => {
      moment.textContent = "at " + clock(time);
      values.forEach((text, index) => { if (cells[index]) cells[index].textContent = text.replace("-", "−"); });
    },
  };
})();
