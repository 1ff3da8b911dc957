// Tables whose rows are kept and refilled, so that a selection or a reader's place in them survives.
// A cell is a text, or {text, state} where it tells how something is.
// A table that has no room stands row by row, every figure below its own heading: nothing is cut off in any language.
const LONG = 28; // letters: from here on a cell goes over several lines
const widths = new WeakMap(); // of each place, when its table was last fitted
const resized = new ResizeObserver((entries) => {
  for (const { target } of entries) if (widths.get(target) !== target.clientWidth) fit(target);
});

function fit(place) {
  if (!widths.has(place)) resized.observe(place);
  widths.set(place, place.clientWidth);
  delete place.dataset.stacked;
  if (place.scrollWidth > place.clientWidth + 1) place.dataset.stacked = "";
}

export function fill(table, heads, rows, empty) {
  if (!table.tHead) {
    table.createTHead().insertRow();
    table.createTBody();
  }
  let changed = false;
  const put = (cell, text) => {
    if (cell.textContent === text) return;
    cell.textContent = text;
    changed = true;
  };
  const head = table.tHead.rows[0];
  while (head.cells.length < heads.length) head.append(Object.assign(document.createElement("th"), { scope: "col" }));
  heads.forEach((text, at) => put(head.cells[at], text));
  const body = table.tBodies[0];
  const wanted = rows.length ? rows : [[empty]];
  table.tHead.hidden = rows.length === 0;
  while (body.rows.length > wanted.length) body.deleteRow(-1);
  wanted.forEach((cells, n) => {
    const row = body.rows[n] ?? body.insertRow();
    while (row.cells.length > cells.length) row.deleteCell(-1);
    cells.forEach((found, at) => {
      const cell = row.cells[at] ?? row.insertCell();
      const text = String(found?.text ?? found);
      put(cell, text);
      cell.classList.toggle("long", text.length > LONG);
      cell.dataset.head = rows.length ? heads[at] : "";
      if (found?.state) cell.dataset.state = found.state;
    });
  });
  if (changed) fit(table.parentElement);
}
