"use strict";
const trace = document.getElementById("trace");
const titleOf = (element) => element.getAttribute("title") || element.querySelector("title")?.textContent || "";

function show(target) {
  const element = target.closest("[title], .step, .bar");
  if (!element) return;
  document.querySelectorAll(".chosen").forEach((other) => other.classList.remove("chosen"));
  element.classList.add("chosen");
  trace.textContent = titleOf(element);
}
document.addEventListener("click", (event) => {
  if (event.target.closest("td[title], .step, .bar")) show(event.target);
  else if (!event.target.closest("#trace")) trace.textContent = "";
});
document.addEventListener("focusin", (event) => {
  if (event.target.matches("td[title]")) show(event.target);
});

// The arrow keys move between the numbers of a table.
document.addEventListener("keydown", (event) => {
  if (event.key === "Escape") trace.textContent = "";
  const cell = event.target.closest("td[title]");
  const move = { ArrowLeft: [0, -1], ArrowRight: [0, 1], ArrowUp: [-1, 0], ArrowDown: [1, 0] }[event.key];
  if (!cell || !move) return;
  const rows = [...cell.closest("tbody").rows].filter((row) => !row.hidden);
  let row = rows.indexOf(cell.parentElement), column = cell.cellIndex, next;
  do {
    row += move[0];
    column += move[1];
    next = rows[row]?.cells[column];
  } while (next && !next.matches("td[title]"));
  if (!next) return;
  event.preventDefault();
  cell.tabIndex = -1;
  next.tabIndex = 0;
  next.focus();
});

const key = (row, column) => {
  const cell = row.cells[column];
  return cell.dataset.order === undefined ? cell.textContent : Number(cell.dataset.order);
};
function compare(a, b) {
  if (typeof a === "number" && typeof b === "number") return (a - b) || 0;
  return typeof a === typeof b ? a.localeCompare(b, "en", { numeric: true }) : typeof a === "number" ? -1 : 1;
}
function sort(head) {
  const descending = head.getAttribute("aria-sort") === "ascending";
  const body = head.closest("table").tBodies[0];
  for (const other of head.parentElement.cells) other.removeAttribute("aria-sort");
  head.setAttribute("aria-sort", descending ? "descending" : "ascending");
  const column = head.cellIndex;
  const rows = [...body.rows].sort((a, b) => compare(key(a, column), key(b, column)));
  body.append(...(descending ? rows.reverse() : rows));
}
for (const head of document.querySelectorAll("table.sortable thead th")) {
  if (!head.textContent) continue;
  const button = document.createElement("button");
  button.type = "button";
  button.textContent = head.textContent;
  button.addEventListener("click", () => sort(head));
  head.replaceChildren(button);
}

for (const input of document.querySelectorAll(".filter input")) {
  const table = input.closest(".table");
  const rows = [...table.querySelectorAll("tbody tr")];
  const texts = rows.map((row) => [...row.cells].map((cell) => cell.textContent).join(" ").toLowerCase());
  input.addEventListener("input", () => {
    const words = input.value.toLowerCase().split(/\s+/).filter(Boolean);
    rows.forEach((row, index) => { row.hidden = !words.every((word) => texts[index].includes(word)); });
    const shown = rows.filter((row) => !row.hidden).length;
    table.querySelector(".count").textContent = words.length ? `${shown} of ${rows.length} rows` : "";
  });
}

// A link to a claim unfolds it; so does printing.
const unfold = () => { const target = document.querySelector(":target"); if (target?.tagName === "DETAILS") target.open = true; };
addEventListener("hashchange", unfold);
unfold();
addEventListener("beforeprint", () => document.querySelectorAll("details.claim").forEach((claim) => { claim.open = true; }));
