/* filter: a click on a scene or method hides or shows it everywhere on the page */

function filterAgain() {
  for (const one of document.querySelectorAll("[data-method], [data-scene]")) {
    const off = Object.keys(hidden).some((kind) => isHidden(kind, one.dataset[kind]));
    one.toggleAttribute("data-off", off);
  }
  for (const redraw of redraws) redraw();
}

function setUpFilter(place) {
  for (const list of place.querySelectorAll(".chips")) {
    const kind = list.dataset.of;
    if (names[kind].length < 2) { list.remove(); continue; }
    names[kind].forEach((name, index) => {
      const button = html("button", "", list);
      button.type = "button";
      button.textContent = name;
      button.addEventListener("click", () => {
        if (!hidden[kind].delete(String(index))) hidden[kind].add(String(index));
        filterAgain();
        remember();
      });
      redraws.push(() => button.setAttribute("aria-pressed", String(!isHidden(kind, index))));
    });
  }
  states.push({
    write(link) {
      for (const kind of Object.keys(hidden)) {
        for (const index of hidden[kind]) link.append(`hide-${kind}`, names[kind][index]);
      }
    },
    read(link) {
      for (const kind of Object.keys(hidden)) {
        const indices = link.getAll(`hide-${kind}`).map((name) => names[kind].indexOf(name));
        hidden[kind] = new Set(indices.filter((index) => index >= 0).map(String));
      }
      place.open ||= Object.values(hidden).some((set) => set.size);
    },
  });
}
