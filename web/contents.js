// The contents of a long page: links to its parts.

import { el } from "./dom.js";

/** The first text of a heading: a badge in it is no part of its name. */
const nameOf = (heading) => heading.firstChild?.textContent.trim() ?? "";

/** Links to the parts of a page that have a heading, in their order; remarks of the service are one part. */
export function contents(body) {
  // the first element of the page is the verdict, which may be a warning, too
  const [remark] = [...body.children].slice(1).filter((one) => one.matches(".warning"));
  const parts = [...body.querySelectorAll("section.card > h2, section.card > .head h2, figure > figcaption > :is(h2, h3), .warning")].filter((one) => !one.closest("details, [hidden]") && (one === remark || !one.matches(".warning")));
  const links = parts.map((part) => {
    const text = part === remark ? "Remarks" : nameOf(part);
    const place = part.closest("section, figure") ?? part;
    return text && el("li", {}, el("a", { href: location.hash, click: (event) => {
      event.preventDefault();
      // A section that is drawn again has another heading.
      const heading = part.isConnected ? part : place.querySelector("h2, h3") ?? place;
      heading.setAttribute("tabindex", -1);
      place.scrollIntoView();
      heading.focus({ preventScroll: true });
    } }, text));
  });
  return el("nav.contents", { "aria-label": "Parts of this page" }, el("ul", {}, links));
}
