// Names for the arrows of the navigation, which the theme leaves without.
for (const summary of document.querySelectorAll("nav details > summary")) {
  const link = summary.closest("li")?.querySelector("a");
  if (link) summary.setAttribute("aria-label", `Pages of ${link.textContent.trim()}`);
}

// Filter of the gallery by subject; the address keeps the choice.
(() => {
  const buttons = [...document.querySelectorAll(".gallery-filter button")];
  if (!buttons.length) return;
  const items = [...document.querySelectorAll(".gallery [class*='subject-']")];
  const sections = [...document.querySelectorAll("article section section")];
  const status = document.querySelector(".gallery-count");

  const select = (subject) => {
    for (const item of items) {
      item.hidden = subject !== "" && !item.classList.contains(`subject-${subject}`);
    }
    for (const section of sections) {
      const cards = [...section.querySelectorAll("[class*='subject-']")];
      section.hidden = cards.length > 0 && cards.every((card) => card.hidden);
    }
    for (const button of buttons) {
      button.setAttribute("aria-pressed", String(button.dataset.subject === subject));
    }
    status.textContent = `${items.filter((item) => !item.hidden).length} of ${items.length} figures`;
  };
  const readAddress = () => {
    const subject = location.hash.replace("#subject=", "");
    select(buttons.some((button) => button.dataset.subject === subject) ? subject : "");
  };

  for (const button of buttons) {
    button.addEventListener("click", () => {
      const { subject } = button.dataset;
      history.replaceState(null, "", subject ? `#subject=${subject}` : location.pathname);
      select(subject);
    });
  }
  addEventListener("hashchange", readAddress);
  if (location.hash) readAddress();
})();
