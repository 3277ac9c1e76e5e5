// SPDX-License-Identifier: Apache-2.0
// The versions beside this one, which `make docs` lists in ../versions.list.js: a script, as a page on a disk may fetch nothing.
document.addEventListener("DOMContentLoaded", () => {
  const root = new URL(document.documentElement.dataset.content_root || "./", document.baseURI);
  const list = document.createElement("script");
  list.src = new URL("../versions.list.js", root);
  list.onload = () => {
    const place = document.querySelector(".sidebar-brand");
    const here = root.pathname.split("/").at(-2);
    const names = window.FPGA_CM_VERSIONS || [];
    if (!place || names.length < 2) return;
    const box = document.createElement("div");
    box.className = "versions";
    const select = box.appendChild(document.createElement("select"));
    select.setAttribute("aria-label", "version of these pages");
    for (const name of names) select.add(new Option(name, name, false, name === here));
    select.addEventListener("change", () => { location.href = new URL(`../${select.value}/index.html`, root); });
    place.after(box);
  };
  document.head.append(list);
});
