// Rules of accessibility, measured in the page itself. Each returns a list of problems.

/** Names, labels, references, headings, one language: what a screen reader needs. */
export const namesAndRoles = page => page.evaluate(() => {
  const problems = [];
  const isShown = e => e.checkVisibility({visibilityProperty: true}) && !e.closest('[hidden]');
  const nameOf = e => {
    const by = (e.getAttribute('aria-labelledby') || '').split(/\s+/).filter(Boolean)
      .map(id => document.getElementById(id)?.textContent ?? '').join(' ');
    const label = e.labels?.length ? [...e.labels].map(l => l.textContent).join(' ') : '';
    return (by || e.getAttribute('aria-label') || label || e.textContent || e.alt || '').trim();
  };
  const what = e => `<${e.tagName.toLowerCase()} id="${e.id}">`;
  for (const e of document.querySelectorAll(
    'button, input, select, textarea, a[href], [role="grid"], [role="tab"], [role="radio"], ' +
    '[role="progressbar"], [role="tablist"], [role="radiogroup"], dialog, canvas[role="img"]')) {
    if (isShown(e) && !nameOf(e)) {
      problems.push(`${what(e)} has no name`);
    }
  }
  for (const attribute of ['aria-labelledby', 'aria-describedby', 'aria-controls', 'aria-activedescendant', 'for']) {
    for (const e of document.querySelectorAll(`[${attribute}]`)) {
      for (const id of e.getAttribute(attribute).split(/\s+/)) {
        if (!document.getElementById(id)) {
          problems.push(`${what(e)} points by ${attribute} to nothing: ${id}`);
        }
      }
    }
  }
  const ids = [...document.querySelectorAll('[id]')].map(e => e.id);
  ids.filter((id, i) => ids.indexOf(id) !== i).forEach(id => problems.push(`id ${id} twice`));
  for (const e of document.querySelectorAll('[tabindex]')) {
    if (Number(e.getAttribute('tabindex')) > 0) {
      problems.push(`${what(e)} changes the order of focus`);
    }
  }
  for (const img of document.querySelectorAll('img:not([alt])')) {
    problems.push(`${what(img)} has no alt`);
  }
  for (const list of document.querySelectorAll('[role="tablist"]')) {
    if (list.querySelectorAll('[role="tab"][aria-selected="true"]').length !== 1) {
      problems.push('not exactly one tab is selected');
    }
  }
  let level = 0;
  for (const heading of [...document.querySelectorAll('h1, h2, h3, h4')].filter(isShown)) {
    const next = Number(heading.tagName[1]);
    if (next > level + 1) {
      problems.push(`heading "${heading.textContent.trim()}" skips a level`);
    }
    level = next;
  }
  for (const [selector, words] of [['main', 'main'], ['header', 'header'], ['h1', 'h1']]) {
    if (document.querySelectorAll(selector).length !== 1) {
      problems.push(`not exactly one ${words}`);
    }
  }
  if (!document.documentElement.lang) {
    problems.push('no language');
  }
  if (!document.querySelector('[role="status"], [aria-live]')) {
    problems.push('nothing is announced');
  }
  return problems;
});

/** Contrast of every text that is shown: 4.5, or 3 for large text (WCAG 2.2, 1.4.3). */
export const contrast = page => page.evaluate(() => {
  const parse = text => {
    const [r, g, b, a = 1] = text.match(/[\d.]+/g).map(Number);
    return {r, g, b, a};
  };
  const over = (top, under) => ({
    r: top.r * top.a + under.r * (1 - top.a), g: top.g * top.a + under.g * (1 - top.a),
    b: top.b * top.a + under.b * (1 - top.a), a: 1,
  });
  const light = c => {
    const [r, g, b] = [c.r, c.g, c.b].map(v => {
      const s = v / 255;
      return s <= 0.04045 ? s / 12.92 : ((s + 0.055) / 1.055) ** 2.4;
    });
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const groundOf = e => {
    const layers = [];
    for (let at = e; at; at = at.parentElement) {
      const colour = parse(getComputedStyle(at).backgroundColor);
      layers.push(colour);
      if (colour.a === 1) {
        break;
      }
    }
    return layers.reduceRight((under, top) => over(top, under), {r: 255, g: 255, b: 255, a: 1});
  };
  const problems = [];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let node = walker.nextNode(); node; node = walker.nextNode()) {
    const e = node.parentElement;
    if (!node.textContent.trim() || !e.checkVisibility({visibilityProperty: true}) ||
        e.closest('.unseen, .skip, option, noscript, script, style, :disabled')) {
      continue;
    }
    const style = getComputedStyle(e);
    const ground = groundOf(e);
    const [a, b] = [light(over(parse(style.color), ground)), light(ground)];
    const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    const size = parseFloat(style.fontSize);
    const isLarge = size >= 24 || (size >= 18.66 && Number(style.fontWeight) >= 700);
    if (ratio < (isLarge ? 3 : 4.5)) {
      problems.push(`"${node.textContent.trim().slice(0, 30)}" has a contrast of ${ratio.toFixed(2)}`);
    }
  }
  return problems;
});

/** Nothing is wider than the screen, and what is tapped is large enough (WCAG 2.2, 2.5.8: 24). */
export const fitsThePhone = page => page.evaluate(() => {
  const problems = [];
  const width = document.documentElement.clientWidth;
  if (document.documentElement.scrollWidth > width) {
    problems.push(`the page is ${document.documentElement.scrollWidth} wide on ${width}`);
  }
  for (const e of document.querySelectorAll('button, select, input, summary')) {
    if (!e.checkVisibility({visibilityProperty: true, opacityProperty: true})) {
      continue;
    }
    const target = (e.type === 'checkbox' || e.type === 'file') && e.closest('label') || e;
    const box = target.getBoundingClientRect();
    if (box.width < 24 || box.height < 24) {
      problems.push(`${e.id || e.textContent} is ${box.width.toFixed(0)} x ${box.height.toFixed(0)}`);
    }
    if (box.right > width + 1 || box.left < -1) {
      problems.push(`${e.id || e.textContent} sticks out`);
    }
  }
  return problems;
});

/** All-off is on the screen, uncovered, wherever the page is scrolled to. */
export const allOffInReach = page => page.evaluate(async () => {
  const problems = [];
  const button = document.getElementById('all-off');
  for (const y of [0, document.body.scrollHeight / 2, document.body.scrollHeight]) {
    window.scrollTo(0, y);
    await new Promise(requestAnimationFrame);
    const box = button.getBoundingClientRect();
    const hit = document.elementFromPoint(box.left + box.width / 2, box.top + box.height / 2);
    if (!button.contains(hit)) {
      problems.push(`all-off is covered or gone at ${y}`);
    }
  }
  window.scrollTo(0, 0);
  return problems;
});

/** What Tab reaches, in order, each with a focus that can be seen. */
export async function tabOrder(page, max = 60) {
  const reached = [];
  const problems = [];
  await page.evaluate(() => document.activeElement?.blur());
  for (let i = 0; i < max; ++i) {
    await page.keyboard.press('Tab');
    const at = await page.evaluate(() => {
      const e = document.activeElement;
      if (!e || e === document.body) {
        return null;
      }
      const style = getComputedStyle(e);
      const label = e.closest('.file');
      const outline = parseFloat(style.outlineWidth) > 0 && style.outlineStyle !== 'none' ||
        label && parseFloat(getComputedStyle(label).outlineWidth) > 0;
      return {name: e.id || e.className || e.tagName, isSeen: Boolean(outline)};
    });
    if (!at || reached.includes(at.name)) {
      break;
    }
    reached.push(at.name);
    if (!at.isSeen) {
      problems.push(`the focus on ${at.name} cannot be seen`);
    }
  }
  return {reached, problems};
}
