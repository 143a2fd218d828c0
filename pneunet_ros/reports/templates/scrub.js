'use strict';
const data = JSON.parse(document.getElementById('frames').textContent);
const slider = document.getElementById('slider');
const stage = document.getElementById('stage');
const bars = document.getElementById('bars');
const SVG = 'http://www.w3.org/2000/svg';
const NARROW = matchMedia('(max-width: 600px)');
const WIDTH = 720, HEIGHT = 200, LEFT = 64, EDGE = 18;

function add(parent, name, attributes, text) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (text !== undefined) element.textContent = text;
  parent.append(element);
}

function line(parent, points, kind) {
  const known = (points || []).filter((point) => point);
  if (known.length) add(parent, 'polyline', { points: known.join(' '), class: kind });
}

function limit() {
  let largest = 50;
  for (const frame of data.frames)
    for (const key of ['from_measured', 'from_predicted'])
      for (const value of frame[key] || []) largest = Math.max(largest, Math.abs(value || 0));
  return largest;
}
const most = limit();

function drawBars(frame) {
  bars.replaceChildren();
  const middle = HEIGHT / 2;
  const x = (s) => LEFT + (WIDTH - LEFT - 10) * s / data.length;
  const y = (value) => middle - (middle - EDGE) * value / most;
  for (const value of [-most, 0, most]) {
    add(bars, 'line', { x1: LEFT, x2: WIDTH, y1: y(value), y2: y(value), class: 'grid' });
    add(bars, 'text', { x: LEFT - 6, y: y(value) + 5, 'text-anchor': 'end' }, value.toFixed(0));
  }
  for (const [key, shift, kind] of [['from_measured', -3, 'measured'], ['from_predicted', 3, 'predicted']])
    (frame[key] || []).forEach((value, target) => {
      if (value === null) return;
      const at = x(data.arclength[target]) + shift;
      add(bars, 'line', { x1: at, x2: at, y1: y(0), y2: y(value), class: `bar ${kind}` });
    });
}

// Numbers stand beside the row, as many as there is room for.
function drawNumbers(frame) {
  const seen = frame.targets.map((point, target) => [target, point]).filter(([, point]) => point);
  const steps = seen.slice(1).map(([target, [u, v]], place) => {
    const [before, [beforeU, beforeV]] = seen[place];
    return [(u - beforeU) / (target - before), (v - beforeV) / (target - before)];
  });
  if (!steps.length) return;
  const lengths = steps.map(([u, v]) => Math.max(Math.hypot(u, v), 1e-9));
  const spacing = [...lengths].sort((a, b) => a - b)[Math.floor(lengths.length / 2)];
  const every = Math.ceil((NARROW.matches ? 36 : 22) / spacing);
  const away = frame.radius + (NARROW.matches ? 18 : 12);
  seen.forEach(([target, [u, v]], place) => {
    if (target % every) return;
    const at = Math.min(place, steps.length - 1);
    const [alongU, alongV] = steps[at].map((value) => value / lengths[at]);
    const middle = NARROW.matches ? 8 : 5;
    add(stage, 'text', { x: u - alongV * away, y: v + alongU * away + middle }, `${target}`);
  });
}

function show(index) {
  const frame = data.frames[index];
  stage.replaceChildren();
  stage.setAttribute('viewBox', `0 0 ${frame.width} ${frame.height}`);
  add(stage, 'image', { href: frame.image, width: frame.width, height: frame.height });
  line(stage, frame.predicted, 'predicted');
  line(stage, frame.measured, 'measured');
  frame.targets.forEach((point) => {
    if (point) add(stage, 'circle', { cx: point[0], cy: point[1], r: frame.radius });
  });
  drawNumbers(frame);
  document.getElementById('said').textContent = frame.text;
  slider.setAttribute('aria-valuetext', frame.text);
  drawBars(frame);
}

document.getElementById('still').remove();
document.getElementById('scrub').hidden = false;
slider.addEventListener('input', () => show(Number(slider.value)));
const asked = location.hash.slice(1);  // page.html#13 opens at that frame
if (/^[0-9]+$/.test(asked)) slider.value = asked;
show(Number(slider.value));
