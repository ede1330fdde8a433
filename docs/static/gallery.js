// Filter of the gallery: one button for each subject; the address keeps the choice.
(() => {
  const container = document.querySelector(".gallery-filter");
  if (!container) return;
  const subjects = JSON.parse(container.dataset.subjects);
  const items = [...document.querySelectorAll(".gallery [class*='subject-']")];
  const sections = [...document.querySelectorAll("article section section")];
  const status = document.createElement("p");
  status.setAttribute("role", "status");
  const buttons = new Map();

  const select = (subject) => {
    for (const item of items) item.hidden = subject && !item.classList.contains(`subject-${subject}`);
    for (const section of sections) {
      const cards = [...section.querySelectorAll("[class*='subject-']")];
      section.hidden = cards.length > 0 && cards.every((card) => card.hidden);
    }
    for (const [key, button] of buttons) button.setAttribute("aria-pressed", String(key === subject));
    status.textContent = `${items.filter((item) => !item.hidden).length} of ${items.length} figures`;
  };

  for (const [key, name] of [["", "All"], ...Object.entries(subjects)]) {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = name;
    button.addEventListener("click", () => {
      history.replaceState(null, "", key ? `#subject=${key}` : location.pathname);
      select(key);
    });
    buttons.set(key, button);
    container.append(button);
  }
  container.after(status);
  const readAddress = () => {
    const key = location.hash.replace("#subject=", "");
    select(key in subjects ? key : "");
  };
  addEventListener("hashchange", readAddress);
  readAddress();
})();
