// Search over the lamps of all pages. Their list, names.js, is loaded on first use: as a script,
// because a page that is opened as a file may load nothing else.
"use strict";

(() => {
  const MOST = 200;
  const field = document.querySelector("input");
  const page = document.querySelector("main");
  const found = document.querySelector("#found");
  const count = document.querySelector("#count");
  const root = document.body.dataset.root;
  const allLamps = count.textContent;
  let loading = false;

  function load() {
    if (!loading) {
      loading = true;
      const script = document.createElement("script");
      script.src = root + "index-files/folder/names.js";
      script.onload = search;
      document.head.append(script);
    }
  }

  function element(name, text, ...children) {
    const made = document.createElement(name);
    made.append(...(text === null ? [] : [text]), ...children);
    return made;
  }

  // A lamp of the list: its name, the suffix of its image, whether it has an asset, and a note.
  function card([name, suffix, hasAsset, note]) {
    const image = element("div", suffix ? null : "no image");
    if (suffix) {
      const shown = element("img", null);
      shown.src = root + "index-files/" + encodeURIComponent(name) + "." + suffix;
      shown.alt = name;
      shown.loading = "lazy";
      image.append(shown);
    }
    const link = element(hasAsset ? "a" : "span", name);
    if (hasAsset) {
      link.href = root + encodeURIComponent(name) + ".lumitree";
    }
    return element("article", null, image,
      element("section", null, element("h2", null, link), element("div", note)));
  }

  function search() {
    const words = field.value.toLowerCase().split(/\s+/).filter(Boolean);
    const searches = words.length > 0 && window.lumitreeLamps !== undefined;
    page.hidden = searches;
    found.hidden = !searches;
    found.replaceChildren();
    count.textContent = allLamps;
    if (searches) {
      const matches = window.lumitreeLamps.filter((lamp) => {
        const text = (lamp[0] + " " + lamp[3]).toLowerCase();
        return words.every((word) => text.includes(word));
      });
      found.append(...matches.slice(0, MOST).map(card));
      count.textContent = matches.length + " found" +
        (matches.length > MOST ? ", of which " + MOST + " are shown." : ".");
    }
  }

  field.hidden = false;
  field.addEventListener("focus", load);
  field.addEventListener("input", () => { load(); search(); });
})();
