/* filter: a click on a scene, method or option hides or shows it everywhere on the page */

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

/* the options in which methods differ: name -> values, where there are several */
function options() {
  const found = new Map();
  for (const name of data.names) {
    for (const part of partsOf(name)) {
      const [key, value] = part.split(/=(.*)/s);
      found.set(key, (found.get(key) ?? new Set()).add(value));
    }
  }
  return [...found].filter(([, values]) => values.size > 1);
}

function chips(list, names, hidden, keyOf) {
  const buttons = names.map((name) => {
    const button = html("button", "", list);
    button.type = "button";
    button.textContent = name;
    button.setAttribute("aria-pressed", "true");
    button.addEventListener("click", () => {
      const key = keyOf(name);
      if (!hidden.delete(key)) hidden.add(key);
      filterAgain();
      remember();
    });
    return [button, keyOf(name)];
  });
  redraws.push(() => {
    for (const [button, key] of buttons) button.setAttribute("aria-pressed", String(!hidden.has(key)));
  });
}

function filterAgain() {
  hideRows();
  for (const redraw of redraws) redraw();
}

function setUpFilter(place) {
  const [scenes, methods] = place.querySelectorAll(".chips");
  chips(scenes, data.scenes, hiddenScenes, (name) => name);
  chips(methods, data.methods, hiddenMethods, (name) => name);
  for (const [key, values] of options()) {
    const list = html("div", "chips", place);
    html("span", "", list).textContent = key;
    chips(list, [...values], hiddenOptions, (value) => `${key}=${value}`);
  }
  const all = { "hide-scene": hiddenScenes, "hide-method": hiddenMethods, "hide-option": hiddenOptions };
  states.push({
    write(link) {
      for (const [key, hidden] of Object.entries(all)) for (const name of hidden) link.append(key, name);
    },
    read(link) {
      for (const [key, hidden] of Object.entries(all)) {
        hidden.clear();
        for (const name of link.getAll(key)) hidden.add(name);
      }
      place.open ||= Object.values(all).some((hidden) => hidden.size);
      hideRows();
    },
  });
}
