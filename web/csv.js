// A CSV file as the service reads it, to show its faults where they stand.

/** Its rows, the header first: the line on which each begins, and its cells. Lines without a character are no rows, and a cell in quotes may go on over several. */
export function rowsOf(text, separator) {
  const rows = [];
  let line = 1;
  for (let at = text.startsWith("\uFEFF") ? 1 : 0; at < text.length;) {
    const end = breakAt(text, at);
    if (end > 0) {
      line += 1;
      at += end;
      continue;
    }
    const row = { line, cells: [] };
    do {
      const cell = cellAt(text, at, separator);
      row.cells.push(cell.text.trim());
      line += cell.lines;
      at = cell.end;
    } while (text[at] === separator && (at += 1));
    rows.push(row);
  }
  return rows;
}

/** Number of characters of the line ending at this position; 0 if there is none. */
function breakAt(text, at) {
  if (text[at] === "\r") return text[at + 1] === "\n" ? 2 : 1;
  return text[at] === "\n" ? 1 : 0;
}

/** The cell that begins here, without the quotes around it; where it ends, and how many ends of line are in it. */
function cellAt(text, from, separator) {
  let [at, lines, found] = [from, 0, ""];
  if (text[at] === '"') {
    for (at += 1; at < text.length && (text[at] !== '"' || text[at + 1] === '"'); at += 1) {
      if (text[at] === '"') at += 1;
      else if (text[at] === "\n" || (text[at] === "\r" && text[at + 1] !== "\n")) lines += 1;
      found += text[at];
    }
    at += 1;
  }
  while (at < text.length && text[at] !== separator && breakAt(text, at) === 0) {
    found += text[at];
    at += 1;
  }
  return { text: found, end: at, lines };
}
