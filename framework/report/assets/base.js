const data = JSON.parse(document.getElementById("data").textContent);

function html(name, className, parent) {
  const made = document.createElement(name);
  made.className = className;
  parent.append(made);
  return made;
}

const redraws = []; // called when the filter changes
const hidden = { scene: new Set(), method: new Set() }; // indices in data.scenes and data.methods
const names = { scene: data.scenes, method: data.methods };
const isHidden = (kind, index) => hidden[kind].has(String(index));

/* permanent links: what is shown and hidden stands behind the # of the address, after a ? */

const states = []; // { write(link), read(link) } of the parts of the page that remember

function remember() {
  const link = new URLSearchParams();
  for (const state of states) state.write(link);
  const text = String(link);
  for (const one of document.querySelectorAll("a.permalink")) one.href = `#?${text}`;
  try {
    history.replaceState(null, "", text ? `#?${text}` : location.pathname + location.search);
  } catch { /* some browsers keep the address of a local file as it is; the link has it */ }
}

function recall() {
  if (location.hash && !location.hash.startsWith("#?")) return; // a heading
  const link = new URLSearchParams(location.hash.slice(2));
  for (const state of states) state.read(link);
  filterAgain();
  for (const one of document.querySelectorAll("a.permalink")) one.href = location.hash || "#?";
}
