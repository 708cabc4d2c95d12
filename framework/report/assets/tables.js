/* tables: a click on a heading sorts, a second one turns the order */

function sortKey(cell) {
  const text = cell.textContent.trim();
  const number = text.replace(/−/g, "-").match(/^[^\d-]{0,4}(-?\d+(?:\.\d+)?)/);
  return number && !cell.classList.contains("left") ? Number(number[1]) : text;
}

function compare(a, b) {
  if (typeof a === "number" && typeof b === "number") return a - b;
  if (typeof a !== typeof b) return typeof a === "number" ? -1 : 1;
  return a.localeCompare(b, "en", { numeric: true });
}

function setUpTable(table) {
  const heads = [...table.tHead.rows[0].cells];
  for (const row of table.tBodies[0].rows) { // on a narrow screen each cell says what it is
    [...row.cells].forEach((cell, column) => { cell.dataset.label = heads[column].textContent; });
  }
  heads.forEach((head, column) => {
    head.querySelector("button").addEventListener("click", () => {
      const down = head.getAttribute("aria-sort") === "ascending";
      for (const other of heads) other.removeAttribute("aria-sort");
      head.setAttribute("aria-sort", down ? "descending" : "ascending");
      const body = table.tBodies[0];
      const keyed = [...body.rows].map((row) => [sortKey(row.cells[column]), row]);
      keyed.sort((one, two) => (down ? -1 : 1) * compare(one[0], two[0]));
      body.append(...keyed.map(([, row]) => row));
    });
  });
}
