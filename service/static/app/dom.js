/** Helper functions for elements of the page. */

/**
 * The element with an id, which index.html is known to have.
 * @param {string} id
 * @returns {any}
 */
export function byId(id) {
  const element = document.getElementById(id);
  if (!element) throw new Error(`the page has no #${id}`);
  return element;
}

/**
 * Make an element. Properties are set as such; `class`, `aria-*`, `data-*` and `for` as attributes.
 * @param {string} tag
 * @param {Record<string, any>} [properties]
 * @param {...(Node | string | null)} children
 * @returns {any}
 */
export function make(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name === "class" || name === "for" || name === "role" || name.includes("-")) {
      element.setAttribute(name, value);
    } else {
      element[name] = value;
    }
  }
  element.append(...children.filter((child) => child !== null));
  return element;
}

/** A canvas that is not on the page. */
export function canvasOf(width, height = width) {
  return make("canvas", { width, height });
}

/** Value of a custom property of the style sheet, such as `--ink`. */
export function styled(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

/** Let the browser paint and its user click. */
export function breathe() {
  return new Promise((resolve) => setTimeout(resolve));
}
