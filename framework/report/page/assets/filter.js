/* filter: a click on a scene or method hides or shows it everywhere on the page */

function hideRows() {
  for (const table of document.querySelectorAll("table")) {
    const heads = [...table.tHead.rows[0].cells].map((head) => head.textContent.trim());
    const scene = heads.indexOf("Scene"), method = heads.indexOf("Method");
    for (const row of table.tBodies[0].rows) {
      const text = (column) => (column < 0 ? "" : row.cells[column].textContent.trim());
      row.hidden = hiddenScenes.has(text(scene).replace(/ °$/, "")) || !isShown(text(method));
    }
  }
  for (const part of document.querySelectorAll("[data-scene]")) part.hidden = hiddenScenes.has(part.dataset.scene);
}

function setUpFilter(place) {
  for (const list of place.querySelectorAll(".chips")) {
    const hidden = list.dataset.of === "scenes" ? hiddenScenes : hiddenMethods;
    for (const name of data[list.dataset.of]) {
      const button = html("button", "", list);
      button.type = "button";
      button.textContent = name;
      button.setAttribute("aria-pressed", "true");
      button.addEventListener("click", () => {
        if (!hidden.delete(name)) hidden.add(name);
        button.setAttribute("aria-pressed", String(!hidden.has(name)));
        hideRows();
        for (const redraw of redraws) redraw();
      });
    }
  }
}
