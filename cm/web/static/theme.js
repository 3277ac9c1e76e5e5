// SPDX-License-Identifier: Apache-2.0
// Light or dark: as the system says, until the user chooses.

const NAMES = { auto: "◐", light: "☀", dark: "☾" };

export function theme(button, changed) {
  const order = Object.keys(NAMES);
  const use = (name) => {
    if (name === "auto") delete document.documentElement.dataset.theme;
    else document.documentElement.dataset.theme = name;
    button.textContent = NAMES[name];
    button.title = `Theme: ${name}`;
    button.setAttribute("aria-label", `Theme: ${name}`);
    changed();
  };
  let now = localStorage.getItem("cm-theme");
  if (!order.includes(now)) now = "auto";
  button.addEventListener("click", () => {
    now = order[(order.indexOf(now) + 1) % order.length];
    localStorage.setItem("cm-theme", now);
    use(now);
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", changed);
  use(now);
}
