// Tables whose rows are kept and refilled, so that a selection or a reader's place in them survives.
export function fill(table, heads, rows, empty) {
  if (!table.tHead) {
    const head = table.createTHead().insertRow();
    for (const text of heads) head.append(Object.assign(document.createElement("th"), { scope: "col", textContent: text }));
    table.createTBody();
  }
  const body = table.tBodies[0];
  const wanted = rows.length ? rows : [[empty]];
  table.tHead.hidden = rows.length === 0;
  while (body.rows.length > wanted.length) body.deleteRow(-1);
  wanted.forEach((cells, n) => {
    const row = body.rows[n] ?? body.insertRow();
    while (row.cells.length > cells.length) row.deleteCell(-1);
    cells.forEach((text, at) => {
      const cell = row.cells[at] ?? row.insertCell();
      if (cell.textContent !== String(text)) cell.textContent = text;
      cell.dataset.head = rows.length ? heads[at] : "";
      if (heads[at] === "State") cell.dataset.state = text;
    });
  });
}
