// Draws the figures of the page: curves that can be zoomed in time, a robot that can be turned. Data stand beside each as JSON.
'use strict';
(() => {
const SVG = 'http://www.w3.org/2000/svg', DASH = {'-': '', '--': '7 4', '-.': '9 3 2 3', ':': '2 3'};
const put = (parent, tag, attributes = {}, text = null) => {
  const e = parent.namespaceURI === SVG || tag === 'svg' ? document.createElementNS(SVG, tag) : document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) e.setAttribute(name, value);
  if (text !== null) e.textContent = text;
  return parent.appendChild(e);
};
const button = (parent, text, label, action) => {
  const b = put(parent, 'button', {type: 'button', 'aria-label': label, title: label}, text);
  b.addEventListener('click', action);
  return b;
};
const remark = figure => put(figure, 'div', {class: 'told', 'aria-live': 'polite'});
// What keys do on a plot, by their names.
const keyed = (svg, keys) => {
  svg.setAttribute('tabindex', '0');
  svg.addEventListener('keydown', e => { if (keys[e.key] && !e.ctrlKey && !e.altKey && !e.metaKey) { keys[e.key](); e.preventDefault(); } });
};
const COARSE = matchMedia('(pointer: coarse)').matches;
const shown = value => Number(value.toPrecision(4)).toString().replace('-', '−');
const ticks = (low, high, most) => {
  const rough = (high - low) / most, ten = 10 ** Math.floor(Math.log10(rough)), step = ten * ([1, 2, 5].find(k => k * ten >= rough) ?? 10), all = [];
  for (let v = Math.ceil(low / step - 1e-9) * step; v <= high + 1e-9 * step; v += step) all.push(Math.abs(v) < 1e-9 * step ? 0 : v);
  return all;
};
const decades = (low, high) => {
  const all = [];
  for (let k = Math.floor(Math.log10(low)); k <= Math.log10(high); k++) for (const m of [1, 2, 5]) if (m * 10 ** k >= low && m * 10 ** k <= high) all.push(m * 10 ** k);
  return all.length > 7 ? all.filter(v => Number.isInteger(Math.round(1e6 * Math.log10(v)) / 1e6)) : all;
};
const symbol = (parent, kind, x, y, color, r = 3) => ({
  s: () => put(parent, 'rect', {x: x - r, y: y - r, width: 2 * r, height: 2 * r, fill: color}),
  '^': () => put(parent, 'path', {d: `M${x} ${y - r}l${r} ${2 * r}h${-2 * r}z`, fill: color}),
  D: () => put(parent, 'path', {d: `M${x} ${y - 1.3 * r}l${1.3 * r} ${1.3 * r}l${-1.3 * r} ${1.3 * r}l${-1.3 * r} ${-1.3 * r}z`, fill: color}),
}[kind] ?? (() => put(parent, 'circle', {cx: x, cy: y, r: kind === '.' ? 0.9 * r : r, fill: color})))();
const sample = (b, role) => {
  const svg = put(b, 'svg', {viewBox: '0 0 28 10', 'aria-hidden': 'true'});
  if (!role.points) put(svg, 'path', {d: 'M0 5H28', stroke: role.color, 'stroke-width': 2, 'stroke-dasharray': DASH[role.line] ?? '', fill: 'none'});
  symbol(svg, role.marker, 14, 5, role.color);
};

function curves(figure, data) {
  const series = [...new Map(data.panels.flatMap(p => p.series).map(s => [s.name, s])).values()], hidden = new Set();
  const legend = put(figure, 'div', {class: 'tools', role: 'group', 'aria-label': 'Curves'});
  for (const s of series) {
    const b = button(legend, '', `show or hide ${s.name}`, () => {
      hidden.has(s.name) ? hidden.delete(s.name) : hidden.add(s.name);
      b.setAttribute('aria-pressed', String(!hidden.has(s.name)));
      draw();
    });
    sample(b, s); b.append(s.name); b.setAttribute('aria-pressed', 'true');
  }
  const wholes = data.panels.map(p => [p.x[0], p.x[p.x.length - 1]]);
  let [from, to] = data.view;  // of what each panel has
  const view = (a, b) => { const width = Math.min(1, Math.max(0.002, b - a)); from = Math.min(1 - width, Math.max(0, a)); to = from + width; draw(); };
  const zoom = factor => { const middle = (from + to) / 2, half = factor * (to - from) / 2; view(middle - half, middle + half); };
  const move = part => view(from + part * (to - from), to + part * (to - from));
  const tools = put(figure, 'div', {class: 'tools', role: 'group', 'aria-label': 'Zoom in time'});
  button(tools, '+', 'zoom in', () => zoom(0.5)); button(tools, '−', 'zoom out', () => zoom(2));
  button(tools, '←', 'earlier', () => move(-0.5)); button(tools, '→', 'later', () => move(0.5));
  button(tools, 'all', 'show all', () => view(0, 1));
  const plots = data.panels.map((_, k) => put(figure, 'svg', {class: 'plot', role: 'application', 'aria-label': data.panels[k].title ? `${data.alt}; ${data.panels[k].title}` : data.alt}));
  const told = remark(figure);
  told.textContent = COARSE ? 'Move a finger across the curves for their values; the buttons zoom.'
    : 'Drag across the curves to zoom, double-click for all. Keys: arrows for values, + and − to zoom, 0 for all.';
  const panel = (svg, p, whole) => {
    const width = Math.max(280, svg.clientWidth), height = Math.round(Math.min(300, 150 + 0.12 * width)), [l, r, t, b] = [56, 10, p.title ? 22 : 10, 40];
    svg.setAttribute('viewBox', `0 0 ${width} ${height}`); svg.replaceChildren();
    const [x0, x1] = [from, to].map(part => whole[0] + part * (whole[1] - whole[0] || 1));
    let first = p.x.findIndex(v => v >= x0), last = p.x.findLastIndex(v => v <= x1);
    if (first < 0 || last < first) [first, last] = [0, p.x.length - 1];
    [first, last] = [Math.max(0, first - 1), Math.min(p.x.length - 1, last + 1)];
    const drawn = p.series.filter(s => !hidden.has(s.name));
    let [low, high] = [Infinity, -Infinity];
    for (const s of drawn) for (let k = first; k <= last; k++) { const v = s.values[k]; if (v !== null && (!p.log || v > 0)) { low = Math.min(low, v); high = Math.max(high, v); } }
    if (!(high >= low)) [low, high] = [p.log ? 0.1 : 0, 1];
    if (p.log) { low = Math.max(low, p.least ?? low); [low, high] = [low / 1.2, 1.2 * high]; }
    else { const spare = Math.max(0.06 * (high - low), (p.span ?? 0) / 2 - (high - low) / 2, 1e-9 + 1e-6 * Math.abs(high)); [low, high] = [p.zero && low >= 0 ? 0 : low - spare, high + spare]; }
    const X = v => l + (v - x0) / (x1 - x0) * (width - l - r), f = p.log ? Math.log : v => v;
    const Y = v => height - b - (f(Math.max(v, p.log ? low / 10 : v)) - f(low)) / (f(high) - f(low)) * (height - t - b);
    for (const v of p.log ? decades(low, high) : ticks(low, high, 5)) {
      put(svg, 'path', {class: 'grid', d: `M${l} ${Y(v)}H${width - r}`}); put(svg, 'text', {x: l - 6, y: Y(v) + 4, 'text-anchor': 'end'}, shown(v));
    }
    for (const v of ticks(x0, x1, width / 90)) {
      put(svg, 'path', {class: 'grid', d: `M${X(v)} ${t}V${height - b}`}); put(svg, 'text', {x: X(v), y: height - b + 16, 'text-anchor': 'middle'}, shown(v));
    }
    put(svg, 'text', {x: (l + width - r) / 2, y: height - 6, 'text-anchor': 'middle'}, p.across);
    put(svg, 'text', {transform: `translate(13 ${(t + height - b) / 2}) rotate(-90)`, 'text-anchor': 'middle'}, p.label);
    if (p.title) put(svg, 'text', {x: l, y: 15, 'font-weight': 600}, p.title);
    const clip = `clip${Math.random().toString(36).slice(2)}`, inner = {x: l, y: t, width: width - l - r, height: height - t - b};
    put(put(put(svg, 'defs'), 'clipPath', {id: clip}), 'rect', inner);
    const area = put(svg, 'g', {'clip-path': `url(#${clip})`});
    for (const s of drawn) {
      let path = '', gap = true;
      for (let k = first; k <= last; k++) {
        const v = s.values[k];
        if (v === null) { gap = true; continue; }
        if (s.points) symbol(area, s.marker, X(p.x[k]), Y(v), s.color, 3);
        else { path += `${gap ? 'M' : 'L'}${X(p.x[k]).toFixed(1)} ${Y(v).toFixed(1)}`; gap = false; }
      }
      if (path) put(area, 'path', {d: path, fill: 'none', stroke: s.color, 'stroke-width': 1.6, 'stroke-dasharray': DASH[s.line] ?? '', 'stroke-linejoin': 'round'});
    }
    put(svg, 'rect', {...inner, class: 'frame'});
    svg.at = event => { const box = svg.getBoundingClientRect(), x = (event.clientX - box.left) * width / box.width; return Math.min(1, Math.max(0, (x - l) / (width - l - r))); };
    svg.tell = part => {
      const x = x0 + part * (x1 - x0); let k = p.x.findIndex(v => v >= x); k = k < 0 ? p.x.length - 1 : k;
      cursor.setAttribute('d', `M${X(p.x[k])} ${t}V${height - b}`);
      const [name, unit] = p.across.split(' in ');
      told.textContent = `${name} ${shown(p.x[k])}${unit ? ` ${unit}` : ''}; ${p.label}: ` + drawn.filter(s => s.values[k] !== null).map(s => `${s.name} ${shown(s.values[k])}`).join(', ');
    };
    const cursor = put(svg, 'path', {class: 'cursor', d: ''});
    svg.forget = () => cursor.setAttribute('d', '');
    svg.mark = (a, z) => { svg.querySelector('.marked')?.remove(); if (z !== undefined) put(svg, 'rect', {class: 'marked', x: l + Math.min(a, z) * inner.width, y: t, width: Math.abs(z - a) * inner.width, height: inner.height, fill: '#1f5fa830'}); };
  };
  const draw = () => plots.forEach((svg, k) => panel(svg, data.panels[k], wholes[k]));
  for (const svg of plots) {
    let start = null;
    svg.addEventListener('pointerdown', e => { if (e.pointerType !== 'touch' && e.button === 0) { start = svg.at(e); svg.setPointerCapture(e.pointerId); e.preventDefault(); } });
    svg.addEventListener('pointermove', e => { svg.tell(svg.at(e)); if (start !== null) svg.mark(start, svg.at(e)); });
    svg.addEventListener('pointerup', e => {
      if (start === null) return;
      const [a, z] = [start, svg.at(e)].sort((x, y) => x - y); start = null; svg.mark();
      if (z - a > 0.01) view(from + a * (to - from), from + z * (to - from));
    });
    svg.addEventListener('pointerleave', () => svg.forget());
    svg.addEventListener('dblclick', () => view(0, 1));
    let place = 0.5;  // of what is shown
    const step = by => { place = Math.min(1, Math.max(0, place + by)); svg.tell(place); };
    keyed(svg, {
      ArrowLeft: () => step(-0.02), ArrowRight: () => step(0.02), Home: () => step(-1), End: () => step(1),
      '+': () => zoom(0.5), '=': () => zoom(0.5), '-': () => zoom(2), '−': () => zoom(2), '0': () => view(0, 1),
    });
  }
  return draw;
}

function robot(figure, data) {
  let [azimuth, elevation, chosen] = [-0.6, 0.35, 0];
  const tools = put(figure, 'div', {class: 'tools', role: 'group', 'aria-label': 'Turn and choose'});
  const turn = (a, e) => { azimuth += a; elevation = Math.min(1.57, Math.max(-0.4, elevation + e)); draw(); };
  button(tools, '←', 'turn left', () => turn(-0.2, 0)); button(tools, '→', 'turn right', () => turn(0.2, 0));
  button(tools, '↑', 'from higher', () => turn(0, 0.15)); button(tools, '↓', 'from lower', () => turn(0, -0.15));
  const label = put(tools, 'label', {}, 'point'), slider = put(label, 'input', {type: 'range', min: 1, max: data.arms.length, value: 1});
  slider.addEventListener('input', () => { chosen = slider.value - 1; draw(); });
  const svg = put(figure, 'svg', {class: 'plot', role: 'application', 'aria-label': data.alt}), told = remark(figure);
  const every = [...data.arms.flat(), ...data.targets], low = [0, 1, 2].map(k => Math.min(...every.map(p => p[k]))), high = [0, 1, 2].map(k => Math.max(...every.map(p => p[k])));
  const middle = low.map((v, k) => (v + high[k]) / 2), size = Math.max(...high.map((v, k) => v - low[k]));
  function draw() {
    const width = Math.max(280, svg.clientWidth), height = Math.min(460, Math.round(0.75 * width + 60)), scale = 0.68 * Math.min(width, height) / size;
    svg.setAttribute('viewBox', `0 0 ${width} ${height}`); svg.replaceChildren();
    const [ca, sa, ce, se] = [Math.cos(azimuth), Math.sin(azimuth), Math.cos(elevation), Math.sin(elevation)];
    const seen = p => { const [x, y, z] = p.map((v, k) => v - middle[k]), side = ca * x + sa * y, deep = -sa * x + ca * y; return [width / 2 + scale * side, height / 2 - scale * (ce * z + se * deep)]; };
    const drawn = (points, attributes) => put(svg, 'path', {d: 'M' + points.map(p => seen(p).map(v => v.toFixed(1)).join(' ')).join('L'), fill: 'none', ...attributes});
    const floor = low[2], corner = [[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]], [low[0], low[1]]].map(([x, y]) => [x, y, floor]);
    drawn(corner, {class: 'grid', style: 'stroke:#00000060'});
    const axis = (k, at) => {
      drawn([at(low[k]), at(high[k])], {class: 'grid', style: 'stroke:#00000060'});
      for (const v of ticks(low[k], high[k], 4)) if (k === 2 || Math.abs(v - middle[k]) < 0.45 * (high[k] - low[k])) { const [x, y] = seen(at(v)); put(svg, 'circle', {cx: x, cy: y, r: 1.6, fill: '#55595e'}); put(svg, 'text', {x: x - 6, y: y + 12, 'text-anchor': 'end'}, shown(v)); }
      let [x, y] = seen(at(high[k] + 0.12 * size));
      if (k < 2) {  // beside the middle of its edge, away from the floor's
        const [cx, cy] = seen([middle[0], middle[1], floor]); [x, y] = seen(at(middle[k]));
        const far = Math.hypot(x - cx, y - cy) || 1; [x, y] = [x + 44 * (x - cx) / far, y + 24 * (y - cy) / far + 20];
      }
      put(svg, 'text', {x, y: y + 4, 'text-anchor': 'middle', 'font-weight': 600}, `${'xyz'[k]} in mm`);
    };
    const near = corner.reduce((a, c) => seen(c)[1] > seen(a)[1] ? c : a), left = corner.reduce((a, c) => seen(c)[0] < seen(a)[0] ? c : a);
    axis(0, v => [v, near[1], floor]); axis(1, v => [near[0], v, floor]); axis(2, v => [left[0], left[1], v]);
    data.arms.forEach((arm, k) => k === chosen || drawn(arm, {stroke: data.robot.color, 'stroke-width': 1, opacity: 0.35}));
    drawn(data.targets, {stroke: data.target.color, 'stroke-dasharray': DASH[data.target.line], 'stroke-width': 1.4});
    drawn(data.arms[chosen], {stroke: data.robot.color, 'stroke-width': 5, 'stroke-linecap': 'round'});
    const tip = data.arms[chosen].at(-1), [x, y] = seen(tip); symbol(svg, 'o', x, y, data.reached.color, 6);
    const [tx, ty, tz] = tip.map(v => shown(Math.round(10 * v) / 10 + 0));
    told.textContent = `point ${chosen + 1}: tip at x ${tx}, y ${ty}, z ${tz} mm`;
    slider.setAttribute('aria-valuetext', told.textContent);
  }
  keyed(svg, {ArrowLeft: () => turn(-0.2, 0), ArrowRight: () => turn(0.2, 0), ArrowUp: () => turn(0, 0.15), ArrowDown: () => turn(0, -0.15)});
  let last = null;
  svg.addEventListener('pointerdown', e => { if (e.pointerType !== 'touch') { last = [e.clientX, e.clientY]; svg.setPointerCapture(e.pointerId); e.preventDefault(); } });
  svg.addEventListener('pointermove', e => { if (last) { turn(-0.008 * (e.clientX - last[0]), 0.008 * (e.clientY - last[1])); last = [e.clientX, e.clientY]; } });
  svg.addEventListener('pointerup', () => { last = null; });
  return draw;
}

for (const figure of document.querySelectorAll('figure.chart')) {
  const data = JSON.parse(figure.querySelector('script').textContent), draw = (data.arms ? robot : curves)(figure, data);
  draw();
  new ResizeObserver(draw).observe(figure);
  addEventListener('beforeprint', draw);
}
})();
