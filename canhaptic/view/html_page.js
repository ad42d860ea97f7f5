const scales = {f: 1e-15, p: 1e-12, n: 1e-9, u: 1e-6, m: 1e-3, k: 1e3, M: 1e6, G: 1e9};
const value = text => {
  const found = text.match(/^[<>=\s]*([-+]?\d+\.?\d*(?:e[-+]?\d+)?)(?![\w.])\s*(?:([fpnumkMG])(?=[A-Za-z]))?/);
  return found ? found[1] * (scales[found[2]] ?? 1) : null;
};
for (const head of document.querySelectorAll("th")) head.addEventListener("click", () => {
  const body = head.closest("table").tBodies[0], sign = head.dataset.down === "1" ? -1 : 1;
  head.dataset.down = sign === 1 ? "1" : "0";
  const text = row => row.cells[head.cellIndex].textContent.trim(), blank = words => words === "" || words === "-";
  const order = (one, other) => {
    const [a, b] = [text(one), text(other)], [x, y] = [value(a), value(b)];
    if (blank(a) || blank(b)) return blank(a) - blank(b);
    return sign * (x !== null && y !== null ? x - y : (x === null) - (y === null) || a.localeCompare(b));
  };
  body.append(...[...body.rows].sort(order));
});
