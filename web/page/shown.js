// SPDX-License-Identifier: Apache-2.0
// Escapes characters by which one name looks like another, as daemon/core/utf8.cpp and
// experiment/slamgw_experiment/events.py do: tests/vectors/shown.json checks all three.
const HIDDEN = '\\u00ad\\u034f\\u061c\\u115f\\u1160\\u17b4\\u17b5\\u180b-\\u180f\\u200b-\\u200f\\u2028-\\u202e\\u2060-\\u206f\\u3164' +
  '\\ufe00-\\ufe0f\\ufeff\\uffa0\\ufff9-\\ufffb\\u{e0000}-\\u{e0fff}';
const FOREIGN = '\\u00a0\\u0250-\\u058f\\u13a0-\\u13ff\\u1c80-\\u1c8f\\u1f00-\\u1fff\\u2000-\\u200a\\u2010-\\u2015\\u202f\\u205f' +
  '\\u2160-\\u217f\\u2212\\u2c80-\\u2cff\\u2de0-\\u2dff\\u3000\\ua640-\\ua69f\\uab70-\\uabbf\\uff00-\\uff5e\\u{1d400}-\\u{1d7ff}';
const LOOK_ALIKE = '\\u0391\\u0392\\u0395-\\u0397\\u0399\\u039a\\u039c\\u039d\\u039f\\u03a1\\u03a4\\u03a5\\u03a7\\u03b1\\u03b9\\u03ba\\u03bd' +
  '\\u03bf\\u03c1\\u03c4\\u03c5\\u03c7\\u03f2\\u03f3\\u03f9\\u0405\\u0406\\u0408\\u0410\\u0412\\u0415\\u041a\\u041c-\\u041e\\u0420-\\u0423' +
  '\\u0425\\u0430\\u0435\\u043e\\u0440\\u0441\\u0443\\u0445\\u0455\\u0456\\u0458\\u04ae\\u04af\\u04ba\\u04bb\\u04c0\\u04cf\\u0501' +
  '\\u051a-\\u051d\\uff21-\\uff5a\\u{1d400}-\\u{1d7ff}';
const any = (set, flags = 'u') => new RegExp(set, flags);
const PLAIN = /^[ -~]*$/;
const WORD = /[0-9A-Za-z\u{80}-\u{10ffff}]+/gu;
const hiddenOrControl = any(`[${HIDDEN}\\u0000-\\u001f\\u007f-\\u009f]`, 'gu');
const foreign = any(`[${FOREIGN}]`, 'gu');
const deceives = any(`[A-Za-z]|^[0-9${HIDDEN}]*[${LOOK_ALIKE}][0-9${HIDDEN}${LOOK_ALIKE}]*$`);

const escaped = (character) => [...character].flatMap((c) => c.split('')).map((unit) => `\\u${unit.charCodeAt(0).toString(16).padStart(4, '0')}`).join('');

export function shown(text) {
  if (typeof text !== 'string' || PLAIN.test(text)) return text;
  return text.replace(WORD, (word) => (deceives.test(word) ? word.replace(foreign, escaped) : word)).replace(hiddenOrControl, escaped);
}

// Returns the name as a shell takes it; null for no name, and for one that cannot be typed safely.
export function typed(name) {
  if (!name || name.startsWith('-') || shown(name) !== name) return null;
  return /^[A-Za-z0-9_.][A-Za-z0-9_.:-]*$/.test(name) ? name : `'${name.replaceAll("'", "'\\''")}'`;
}
