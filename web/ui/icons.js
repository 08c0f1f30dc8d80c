// Icons, so that colour is never the only sign: 24 by 24, in the colour of the surrounding text.

const SVG = "http://www.w3.org/2000/svg";

/** @type {Record<string, string>} */
const PATHS = {
  play: "M7 4.5v15l12.5-7.5z",
  pause: "M6 4.5h4.2v15H6zM13.8 4.5H18v15h-4.2z",
  resume: "M4 4.5h3.6v15H4zM10.5 4.5v15l10-7.5z",
  stop: "M5 5h14v14H5z",
  abort: "M8 2.5h8L21.5 8v8L16 21.5H8L2.5 16V8zM8.6 7.2 7.2 8.6l3.4 3.4-3.4 3.4 1.4 1.4 3.4-3.4 3.4 3.4 1.4-1.4-3.4-3.4 3.4-3.4-1.4-1.4-3.4 3.4z",
  reset: "M12 4a8 8 0 1 1-7.6 10.5l2.4-.8A5.5 5.5 0 1 0 8 8.1L10.6 11H3V3.4l3.2 3.1A8 8 0 0 1 12 4z",
  wait: "M6 2.5h12v2.4l-4.6 7.1 4.6 7.1v2.4H6v-2.4l4.6-7.1L6 4.9zm3 2.4 3 4.6 3-4.6zm3 9.6-3 4.6h6z",
  done: "M9.4 18.9 2.9 12.4l2.3-2.3 4.2 4.2 9.4-9.4 2.3 2.3z",
  ready: "M12 3a9 9 0 1 1 0 18 9 9 0 0 1 0-18zm0 2.6a6.4 6.4 0 1 0 0 12.8 6.4 6.4 0 0 0 0-12.8z",
  alarm: "M12 2.5 22.5 21h-21zM10.9 9.3v6h2.2v-6zm0 7.6v2.1h2.2v-2.1z",
  link: "M2 9a14 14 0 0 1 20 0l-2 2a11.2 11.2 0 0 0-16 0zm4 4a8.5 8.5 0 0 1 12 0l-2 2a5.7 5.7 0 0 0-8 0zm4 4a2.8 2.8 0 0 1 4 0l-2 2.200z",
  unlink: "M3.5 2 22 20.5 20.5 22l-7-7A5.7 5.7 0 0 0 8 15l-2-2a8.5 8.5 0 0 1 4-2.300L7.7 8.400A11.2 11.2 0 0 0 4 11L2 9a14 14 0 0 1 3.6-2.600L2 3.5zM13 5a14 14 0 0 1 9 4l-2 2a11.2 11.2 0 0 0-5-2.800zM10 17a2.8 2.8 0 0 1 4 0l-2 2.200z",
  theme: "M12 3a9 9 0 1 1 0 18 9 9 0 0 1 0-18zm0 2.400v13.200a6.6 6.6 0 0 0 0-13.200z",
  load: "M11 3h2.400v8.200l3-3L18 9.9 12.2 15.7 6.4 9.900l1.6-1.7 3 3zM4 17.5h16.400V20H4z",
  close: "M6.4 4.9 12 10.5l5.6-5.6 1.5 1.5-5.6 5.6 5.6 5.6-1.5 1.5-5.6-5.6-5.6 5.6-1.5-1.5 5.6-5.6-5.6-5.600z",
  trash: "M9 3h6l1 2h4v2.200H4V5h4zM6 8.5h12L17 21H7z",
  home: "M12 3 2.5 11.200l1.5 1.7L5.500 11.600V20.500h5v-6h3v6h5v-8.900l1.500 1.300 1.500-1.700z",
  back: "M10 4.5v5h4a6 6 0 0 1 0 12H7V19h7a3.500 3.500 0 0 0 0-7h-4v5L2.500 10.800z",
  edit: "M4 16.200V20h3.800L18.600 9.200l-3.800-3.800zM16 4.200l3.800 3.800 1.200-1.200a1.6 1.6 0 0 0 0-2.300l-1.500-1.500a1.6 1.6 0 0 0-2.300 0z",
  rename: "M3 7h9v2.200H5.200v5.600H12V17H3zm11 0h7v10h-7v-2.200h4.800V9.200H14zM12 3.500h4v2h-1v13h1v2h-4v-2h1v-13h-1z",
  folder: "M2.500 5h7l2.200 2.500H21.500V19.500H2.500z",
  file: "M6 2.500h8.500L19 7v14.500H6zm7.500 1.800V8H17z",
  user: "M12 3a4.500 4.500 0 1 1 0 9 4.500 4.500 0 0 1 0-9zm-8.500 17.500c0-4 4-6.500 8.500-6.500s8.500 2.500 8.500 6.500z",
  far: "M3 3h7v2.500H7.300l3.500 3.500-1.800 1.800-3.500-3.500V10H3zm11 0h7v7h-2.500V7.300L15 10.800 13.200 9l3.500-3.500H14zM3 14h2.500v2.700L9 13.200l1.800 1.800-3.500 3.500H10V21H3zm15.500 0H21v7h-7v-2.500h2.700L13.200 15l1.800-1.800 3.500 3.500z",
  ended: "M3 3h18v18H3zm2.600 2.600v12.800h12.800V5.600zM8.500 8.500h7v7h-7z",
  save: "M11 3h2.400v8.200l3-3L18 9.900 12.200 15.700 6.400 9.900l1.600-1.700 3 3zM4 15.500h2.400v2.200h11.600v-2.200h2.400V20H4z",
  search: "M10 3a7 7 0 0 1 5.600 11.200l5.200 5.200-1.600 1.600-5.200-5.200A7 7 0 1 1 10 3zm0 2.300a4.700 4.700 0 1 0 0 9.400 4.700 4.700 0 0 0 0-9.400z",
  history: "M12 3a9 9 0 1 1-8.700 11.300l2.400-.600A6.500 6.500 0 1 0 7.200 7.600L9.600 10H3V3.400l2.500 2.500A9 9 0 0 1 12 3zm-1.100 4.200h2.200v4.500l3.500 2.100-1.100 1.900-4.600-2.800z",
  info: "M12 3a9 9 0 1 1 0 18 9 9 0 0 1 0-18zm-1.2 7.5v6.5h2.400v-6.5zm0-3.5v2.300h2.400V7z",
};

/**
 * Returns an icon, hidden from screen readers because the word next to it has the same meaning.
 * @param {string} name
 * @returns {SVGSVGElement}
 */
export function icon(name) {
  const svg = document.createElementNS(SVG, "svg");
  svg.setAttribute("viewBox", "0 0 24 24");
  svg.setAttribute("class", "icon");
  svg.setAttribute("aria-hidden", "true");
  const path = document.createElementNS(SVG, "path");
  path.setAttribute("fill-rule", "evenodd");
  svg.append(path);
  setIcon(svg, name);
  return svg;
}

/**
 * Changes the picture of an icon.
 * @param {SVGSVGElement} svg
 * @param {string} name
 */
export function setIcon(svg, name) {
  if (svg.dataset.name === name) return;
  svg.dataset.name = name;
  svg.firstElementChild?.setAttribute("d", PATHS[name] ?? "");
}
