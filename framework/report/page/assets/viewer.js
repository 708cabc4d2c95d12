/* viewer: a shot is [scene, method, seed, view, PSNR, truth, render, error] */

function setUpViewer(viewer) {
  const selects = [...viewer.querySelectorAll("select")];
  const slider = viewer.querySelector("input");
  const [truth, render, error] = viewer.querySelectorAll(".stage img");
  const seam = viewer.querySelector(".seam");
  const wanted = new Map(); // what was chosen last, where it exists

  function refill() {
    let left = data.shots.filter((shot) => !hiddenScenes.has(shot[0]) && isShown(shot[1]));
    if (!left.length) left = data.shots;
    for (const select of selects) {
      const key = Number(select.dataset.key);
      const values = [...new Set(left.map((shot) => shot[key]))];
      if (key === 2) values.sort((a, b) => a - b);
      const kept = values.includes(wanted.get(key)) ? wanted.get(key) : values[0];
      select.replaceChildren(...values.map((value) => new Option(String(value), String(value), false, value === kept)));
      left = left.filter((shot) => shot[key] === kept);
    }
    show(left[0]);
  }

  function show(shot) {
    truth.src = data.images[shot[5]];
    render.src = data.images[shot[6]];
    error.src = data.images[shot[7]];
    viewer.querySelector(".psnr").textContent = `(${shot[4]})`;
  }

  function wipe() {
    const value = Number(slider.value), share = value <= 1 ? value : value - 1;
    const cut = (part) => `inset(0 ${100 - 100 * part}% 0 0)`;
    render.style.clipPath = cut(Math.min(1, value));
    error.style.clipPath = cut(Math.max(0, value - 1));
    seam.style.left = `calc(${100 * share}% - 1px)`;
    seam.style.visibility = share > 0 && share < 1 ? "visible" : "hidden";
    slider.setAttribute("aria-valuetext", ["ground truth", "render", "error map"][Math.round(value)]);
  }

  for (const select of selects) {
    select.addEventListener("change", () => {
      const key = Number(select.dataset.key);
      wanted.set(key, key === 2 ? Number(select.value) : select.value);
      refill();
    });
  }
  for (const button of viewer.querySelectorAll(".marks button")) {
    button.addEventListener("click", () => { slider.value = button.dataset.to; wipe(); });
  }
  slider.addEventListener("input", wipe);
  redraws.push(refill);
  refill();
  wipe();
}
