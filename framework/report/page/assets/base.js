const data = JSON.parse(document.getElementById("data").textContent);
const SVG = "http://www.w3.org/2000/svg";

function element(name, attributes, parent) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (parent) parent.append(made);
  return made;
}

function html(name, className, parent) {
  const made = document.createElement(name);
  made.className = className;
  parent.append(made);
  return made;
}

const redraws = []; // what to call when the filter changes
const hiddenScenes = new Set(), hiddenMethods = new Set(), hiddenOptions = new Set();

/* a name belongs to a method if it is that, or goes on with its options or its number of runs */
function methodOf(name) {
  const fits = data.methods.filter((m) => name === m || name.startsWith(`${m}, `) || name.startsWith(`${m} (`));
  return fits.sort((a, b) => b.length - a.length)[0];
}

/* `safi + uar, steps=75 (n = 3)` as augment=safi, reg=uar, steps=75 */
function partsOf(name) {
  const [pair, ...rest] = name.replace(/ \(n = \d+\)$/, "").split(", ");
  const [augment, reg] = pair.split(" + ");
  const groups = reg === undefined ? [] : [`augment=${augment}`, `reg=${reg}`];
  return [...groups, ...rest.filter((part) => part.includes("="))];
}

const hasHidden = (parts) => parts.some((part) => hiddenOptions.has(part));
const isShown = (name) => !hiddenMethods.has(methodOf(name)) && !(hiddenOptions.size && hasHidden(partsOf(name)));
const isShownPoint = (note) => !(hiddenOptions.size && hasHidden(note.split(", ")));
