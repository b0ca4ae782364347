// Names for controls of the theme that show only a sign, and the whole visible text for the button of the search.
// The empty corner of a table is no heading. Long code in a table breaks between its words, not within them.
document.addEventListener("DOMContentLoaded", () => {
  for (const summary of document.querySelectorAll(".bd-sidebar-primary summary")) {
    const link = summary.closest("li")?.querySelector("a");
    summary.setAttribute("aria-label", `Pages of ${link ? link.textContent.trim() : "this part"}`);
    summary.querySelector("[role=presentation]")?.setAttribute("aria-hidden", "true");
  }
  for (const button of document.querySelectorAll("button.search-button-field")) {
    button.setAttribute("aria-label", button.innerText.replace(/\s+/g, " ").trim() || "Search");
  }
  for (const corner of document.querySelectorAll(".bd-article th")) {
    if (!corner.textContent.trim()) {
      const cell = document.createElement("td");
      cell.className = corner.className;
      corner.replaceWith(cell);
    }
  }
  for (const code of document.querySelectorAll(".bd-article td code span.pre")) {
    const parts = code.textContent.split(/(?<=[/_(.,=])/);
    code.replaceChildren(...parts.flatMap((part, i) => (i ? [document.createElement("wbr"), part] : [part])));
  }
});
