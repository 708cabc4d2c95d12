/* viewer: a shot is [scene, method, seed, view, PSNR, truth, render, error, index of the method] */

function fill(select, values, kept) {
  select.replaceChildren(...values.map((v) => new Option(String(v), String(v), false, v === kept)));
}

function fly(place, videos, seed) { // the method's small video; it stays while it is the same
  const found = videos.find((one) => one[2] === seed) ?? videos[0], shown = place.querySelector(".flight");
  if (shown?.src === found?.[3]) return;
  place.replaceChildren();
  if (!found) return;
  const isVideo = found[3].startsWith("data:video"), flight = document.createElement(isVideo ? "video" : "img");
  const text = `flight through the scene, ${found[1]}, seed ${found[2]}`;
  if (isVideo) Object.assign(flight, { controls: true, loop: true, muted: true, playsInline: true });
  else flight.alt = text;
  Object.assign(flight, { className: "flight", src: found[3], title: text });
  place.append(flight);
}

function setUpPane(pane, moving) {
  const [method, seed] = pane.querySelectorAll("select");
  const [truth, render, error] = pane.querySelectorAll(".stage img");
  const seam = pane.querySelector(".seam");
  const chosen = { method: null, seed: null }; // what was chosen last, where it exists
  return {
    chosen, method, seed,
    offer(shots, taken) { // without a choice, another method than is taken; returns which
      const methods = [...new Set(shots.map((shot) => shot[1]))];
      const other = methods.find((name) => name !== taken) ?? methods[0];
      const own = methods.includes(chosen.method) ? chosen.method : other;
      const seeds = [...new Set(shots.filter((shot) => shot[1] === own).map((shot) => shot[2]))].sort((a, b) => a - b);
      const kept = seeds.includes(chosen.seed) ? chosen.seed : seeds[0];
      fill(method, methods, own);
      fill(seed, seeds, kept);
      const shot = shots.find((one) => one[1] === own && one[2] === kept);
      [truth.src, render.src, error.src] = [5, 6, 7].map((k) => data.images[shot[k]]);
      const told = pane.querySelector(".told");
      told.textContent = `${own}, seed ${kept}: ${shot[4]}`;
      for (const [scene, method, seed, text, target] of data.looks) { // what else shows this run
        if (scene !== shot[0] || method !== own || seed !== kept) continue;
        const link = document.createElement("a");
        link.href = target;
        link.textContent = text;
        told.append(" · ", link);
      }
      fly(moving, data.videos.filter((one) => one[0] === shot[0] && one[1] === own), kept);
      return own;
    },
    wipe(value) {
      const cut = (part) => `inset(0 ${100 - 100 * part}% 0 0)`;
      render.style.clipPath = cut(Math.min(1, value));
      error.style.clipPath = cut(Math.max(0, value - 1));
      const share = value <= 1 ? value : value - 1;
      seam.style.left = `calc(${100 * share}% - 1px)`;
      seam.style.visibility = share > 0 && share < 1 ? "visible" : "hidden";
    },
  };
}

function setUpViewer(viewer) {
  const [scenes, views] = viewer.querySelectorAll(":scope > .choices select");
  const slider = viewer.querySelector("input"), beside = viewer.querySelector(".beside");
  const places = [...viewer.querySelectorAll(".pane")], flights = [...viewer.querySelectorAll(".moving")];
  const panes = places.map((pane, k) => setUpPane(pane, flights[k]));
  const wanted = { scene: null, view: null };
  if (new Set(data.shots.map((shot) => shot[1] + shot[2])).size < 2) beside.hidden = true;

  function refill() {
    const isShown = (shot) => !isHidden("scene", data.scenes.indexOf(shot[0])) && !isHidden("method", shot[8]);
    let left = data.shots.filter(isShown);
    if (!left.length) left = data.shots;
    for (const [select, key, name] of [[scenes, 0, "scene"], [views, 3, "view"]]) {
      const values = [...new Set(left.map((shot) => shot[key]))];
      const kept = values.includes(wanted[name]) ? wanted[name] : values[0];
      fill(select, values, kept);
      left = left.filter((shot) => shot[key] === kept);
    }
    panes[1].offer(left, panes[0].offer(left));
  }

  function wipe() {
    const value = Number(slider.value);
    for (const pane of panes) pane.wipe(value);
    slider.setAttribute("aria-valuetext", ["ground truth", "render", "error map"][Math.round(value)]);
  }

  function pair(on) {
    places[1].hidden = flights[1].hidden = !on;
    viewer.classList.toggle("two", on);
    beside.setAttribute("aria-pressed", String(on));
  }

  const changed = (set) => (event) => { set(event.target.value); refill(); remember(); };
  scenes.addEventListener("change", changed((value) => { wanted.scene = value; }));
  views.addEventListener("change", changed((value) => { wanted.view = value; }));
  for (const { method, seed, chosen } of panes) {
    method.addEventListener("change", changed((value) => { chosen.method = value; }));
    seed.addEventListener("change", changed((value) => { chosen.seed = Number(value); }));
  }
  for (const button of viewer.querySelectorAll(".marks button")) {
    button.addEventListener("click", () => { slider.value = button.dataset.to; wipe(); remember(); });
  }
  slider.addEventListener("input", wipe);
  slider.addEventListener("change", remember);
  beside.addEventListener("click", () => { pair(places[1].hidden); remember(); });
  redraws.push(refill);
  states.push({
    write(link) { // only what was chosen: a link to the page as it opens is short
      for (const key of ["scene", "view"]) if (wanted[key] !== null) link.set(key, wanted[key]);
      panes.forEach(({ chosen }, k) => {
        if (chosen.method !== null) link.set(`method${k + 1}`, chosen.method);
        if (chosen.seed !== null) link.set(`seed${k + 1}`, chosen.seed);
      });
      if (places[1].hidden === data.beside) link.set("two", data.beside ? "0" : "1");
      if (slider.value !== "0.5") link.set("at", slider.value);
    },
    read(link) {
      for (const key of ["scene", "view"]) wanted[key] = link.get(key);
      panes.forEach(({ chosen }, k) => {
        chosen.method = link.get(`method${k + 1}`);
        chosen.seed = link.has(`seed${k + 1}`) ? Number(link.get(`seed${k + 1}`)) : null;
      });
      pair(link.has("two") !== data.beside && !beside.hidden);
      slider.value = link.get("at") ?? "0.5";
      wipe();
    },
  });
  refill();
  wipe();
}
