// Names for controls of the theme that show only a sign, and the whole visible text for the button of the search.
// "/" opens the search, a chosen color mode keeps the focus at its menu, and the page of results begins at its search box.
// A formula that is wider than the page can be scrolled by keys.
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
    const parts = code.textContent.match(/[^/_(.,=]*[/_(.,=]|[^/_(.,=]+$/g) || [];
    code.replaceChildren(...parts.flatMap((part, i) => (i ? [document.createElement("wbr"), part] : [part])));
  }
  document.addEventListener("keydown", (event) => {
    const isTyping = event.target.closest("input, textarea, select, [contenteditable]");
    if (event.key === "/" && !event.ctrlKey && !event.metaKey && !event.altKey && !isTyping) {
      event.preventDefault();
      document.querySelector(".search-button__button")?.click();
    }
  });
  for (const choice of document.querySelectorAll(".theme-change-button")) {
    choice.addEventListener("click", () => choice.closest(".dropdown").querySelector(".theme-switch-button").focus());
  }
  document.querySelector("#search-results")?.parentElement.querySelector("input[type=search]")?.focus();
});

window.addEventListener("load", () => {
  const reach = () => {
    for (const formula of document.querySelectorAll("div.math mjx-container")) {
      if (formula.scrollWidth > formula.clientWidth) formula.setAttribute("tabindex", "0");
      else formula.removeAttribute("tabindex");
    }
  };
  window.MathJax?.startup?.promise?.then(reach);
  window.addEventListener("resize", reach);
});
