// SPDX-License-Identifier: Apache-2.0
// The occupancy grid as ROS's map_server reads it: a PGM picture, and a YAML text with its place. Metres, y up.
import { CELL_CM } from './grid.js';

const SIDE = 64; // cells of a tile's edge
const [WALL, FREE, UNKNOWN] = [0, 254, 205]; // as map_saver writes them
const MOST_CELLS = 1 << 25; // 32 MB; a larger picture comes from a few far readings and is almost empty

// Returns null while the grid is empty, or when its parts lie too far apart for one picture.
export function rosMap(grid, name) {
  const tiles = [...grid.tiles.values()];
  if (!tiles.length) return null;
  const span = (values) => [Math.min(...values), Math.max(...values) + 1];
  const [left, right] = span(tiles.map((tile) => tile.column));
  const [bottom, top] = span(tiles.map((tile) => tile.row));
  const [width, height] = [(right - left) * SIDE, (top - bottom) * SIDE];
  if (width * height > MOST_CELLS) return null;
  const pixels = new Uint8Array(width * height).fill(UNKNOWN);
  for (const tile of tiles) {
    for (let row = 0; row < SIDE; row++) {
      const line = height - 1 - ((tile.row - bottom) * SIDE + row); // the first line of a picture is its upper one
      for (let column = 0; column < SIDE; column++) {
        const value = tile.cells[row * SIDE + column];
        if (value !== 0) pixels[line * width + (tile.column - left) * SIDE + column] = value > 0 ? WALL : FREE;
      }
    }
  }
  const metres = (tile) => (tile * SIDE * CELL_CM / 100).toFixed(2);
  const yaml = `image: ${name}.pgm\nresolution: ${CELL_CM / 100}\norigin: [${metres(left)}, ${metres(bottom)}, 0.0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n`;
  return { pgm: [`P5\n${width} ${height}\n255\n`, pixels], yaml };
}
