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
  for (const redraw of redraws) redraw();
  for (const one of document.querySelectorAll("a.permalink")) one.href = location.hash || "#?";
}
