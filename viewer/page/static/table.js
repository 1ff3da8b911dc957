// Tables whose rows are kept and refilled, so that a selection or a reader's place in them survives.
// A cell is a text, or {text, state} where it tells how something is.
export function fill(table, heads, rows, empty) {
  if (!table.tHead) {
    table.createTHead().insertRow();
    table.createTBody();
  }
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
      put(cell, String(found?.text ?? found));
      cell.dataset.head = rows.length ? heads[at] : "";
      if (found?.state) cell.dataset.state = found.state;
    });
  });
}

function put(cell, text) {
  if (cell.textContent !== text) cell.textContent = text;
}
