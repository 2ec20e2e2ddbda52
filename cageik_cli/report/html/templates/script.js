"use strict";

document.documentElement.classList.add("scripted");

const status = document.getElementById("status");

const announce = (text) => { status.textContent = text; };

// A click on a column's title sorts the rows, except in a body marked `fixed`.
function makeSortable(table) {
  const titles = [...table.querySelectorAll("thead th[data-sort]")];
  const body = table.querySelector("tbody:not(.fixed)");
  if (!body) return;
  const collator = new Intl.Collator("en", { numeric: true });
  const valueOf = (row, column, kind) => {
    const cell = row.cells[column];
    if (!cell || cell.hasAttribute("data-skipped")) return null;
    const text = cell.dataset.value ?? cell.textContent.trim();
    if (kind !== "number") return text;
    const value = Number.parseFloat(text.replace(/\s/g, "")); // digits are in groups
    return Number.isNaN(value) ? null : value;
  };
  const sort = (title) => {
    const column = title.cellIndex, kind = title.dataset.sort;
    const old = title.getAttribute("aria-sort");
    const first = kind === "number" && column > 0 ? "descending" : "ascending";
    const order = old === "none" ? first : old === "ascending" ? "descending" : "ascending";
    const sign = order === "ascending" ? 1 : -1;
    const rows = [...body.rows].map((row) => [valueOf(row, column, kind), row]);
    rows.sort(([a], [b]) => {
      if (a === null || b === null) return (a === null) - (b === null);
      return sign * (kind === "number" ? a - b : collator.compare(a, b));
    });
    body.append(...rows.map(([, row]) => row));
    for (const other of titles) other.setAttribute("aria-sort", other === title ? order : "none");
    announce(`sorted by ${title.textContent}, ${order}`);
  };
  for (const title of titles) {
    const button = document.createElement("button");
    button.type = "button";
    button.append(...title.childNodes);
    title.append(button);
    if (!title.hasAttribute("aria-sort")) title.setAttribute("aria-sort", "none");
    button.addEventListener("click", () => sort(title));
  }
}

// Hides rows whose names do not contain all words that were typed.
function makeFilter(input) {
  const rows = [...document.getElementById(input.dataset.filters).querySelectorAll("tbody tr")];
  const names = rows.map((row) => row.querySelector("th").textContent.toLowerCase());
  const count = document.getElementById(input.dataset.counts);
  input.addEventListener("input", () => {
    const words = input.value.toLowerCase().split(/\s+/).filter(Boolean);
    let shown = 0;
    rows.forEach((row, k) => {
      row.hidden = !words.every((word) => names[k].includes(word));
      shown += !row.hidden;
    });
    count.textContent = `${shown} of ${rows.length} shown`;
  });
}

// A cursor over the plot shows the table's values of a frame.
function makeCursor(plot) {
  const table = document.getElementById("frames-table");
  const titles = [...table.tHead.rows[0].cells];
  const rows = [...table.tBodies[0].rows];
  const [left, right, top, bottom, first, last] =
    ["left", "right", "top", "bottom", "first", "last"].map((key) => Number(plot.dataset[key]));
  const cursor = plot.querySelector(".cursor"), tip = plot.querySelector(".tip");
  const shownColumns = titles.map((title, column) => [title.dataset.cursor, column]).filter(([label]) => label);
  let current = null;

  const positionOf = (frame) => left + (frame - first) / (last - first) * (right - left);
  const factsOf = (row) => {
    const skipped = row.querySelector("[data-skipped]");
    if (skipped) return [["", skipped.textContent]];
    return shownColumns.map(([label, column]) => [label, row.cells[column].textContent]);
  };
  const line = ([label, value]) => {
    const span = document.createElement("span");
    for (const text of [label, value].filter(Boolean)) {
      span.append(Object.assign(document.createElement("i"), { textContent: text }));
    }
    return span;
  };
  const move = (frame) => {
    if (frame === current) return;
    current = frame;
    const row = rows[frame], name = row.querySelector("th").textContent, facts = factsOf(row);
    const position = positionOf(frame);
    Object.assign(cursor.style, {
      left: `${100 * position}%`, top: `${100 * top}%`, height: `${100 * (bottom - top)}%`,
    });
    tip.replaceChildren(Object.assign(document.createElement("b"), { textContent: name }));
    tip.append(...facts.map(line));
    const before = position > (left + right) / 2;
    Object.assign(tip.style, {
      top: `${100 * top + 2}%`,
      left: before ? "auto" : `calc(${100 * position}% + 10px)`,
      right: before ? `calc(${100 - 100 * position}% + 10px)` : "auto",
    });
    cursor.hidden = tip.hidden = false;
    plot.setAttribute("aria-valuenow", frame);
    plot.setAttribute("aria-valuetext", name);
    announce(`frame ${row.cells[0].textContent}, ${name}: ${facts.map((fact) => fact.filter(Boolean).join(" ")).join(", ")}`);
  };
  const hide = () => { cursor.hidden = tip.hidden = true; current = null; };

  const start = Number(plot.dataset.start);
  plot.tabIndex = 0;
  plot.setAttribute("role", "slider");
  plot.setAttribute("aria-label", "Frame of the plot");
  plot.setAttribute("aria-valuemin", 0);
  plot.setAttribute("aria-valuemax", rows.length - 1);
  plot.setAttribute("aria-valuenow", start);
  plot.setAttribute("aria-valuetext", rows[start].querySelector("th").textContent);
  const point = (event) => {
    const box = plot.getBoundingClientRect();
    const across = ((event.clientX - box.left) / box.width - left) / (right - left);
    const frame = Math.round(first + across * (last - first));
    move(Math.max(0, Math.min(rows.length - 1, frame)));
  };
  plot.addEventListener("pointermove", point);
  plot.addEventListener("pointerdown", point);
  plot.addEventListener("pointerleave", () => { if (document.activeElement !== plot) hide(); });
  plot.addEventListener("focus", () => move(current ?? start));
  plot.addEventListener("blur", hide);
  plot.addEventListener("keydown", (event) => {
    const now = current ?? start;
    const next = {
      ArrowLeft: now - 1, ArrowDown: now - 1, ArrowRight: now + 1, ArrowUp: now + 1,
      PageDown: now - 10, PageUp: now + 10, Home: 0, End: rows.length - 1,
    }[event.key];
    if (next === undefined || event.ctrlKey || event.altKey || event.metaKey) return;
    event.preventDefault();
    move(Math.max(0, Math.min(rows.length - 1, next)));
  });
}

// A button shows the pictures of a pose over the whole width, or small again.
function makeSizable(button) {
  button.addEventListener("click", () => {
    const isLarge = button.closest(".pose").classList.toggle("large");
    button.setAttribute("aria-pressed", isLarge);
  });
}

// A button copies a text. Only some pages are given the clipboard; to copy what is selected works on all.
function makeCopier(button) {
  button.addEventListener("click", () => {
    getSelection().selectAllChildren(document.getElementById(button.dataset.copies));
    button.textContent = document.execCommand("copy") ? "Copied" : "Selected: press Ctrl+C";
    announce(button.textContent);
  });
}

document.querySelectorAll("button.size").forEach(makeSizable);
document.querySelectorAll("#plot").forEach(makeCursor);
document.querySelectorAll("button.copy").forEach(makeCopier);
document.querySelectorAll("table.sortable").forEach(makeSortable);
document.querySelectorAll("input[data-filters]").forEach(makeFilter);
