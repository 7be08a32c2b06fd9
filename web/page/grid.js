// SPDX-License-Identifier: Apache-2.0
// Occupancy grid: cells of 2 cm, free along each ray, occupied at its end. Tiles hold 64 x 64 cells and a picture of them,
// which is painted again when a cell has changed.
export const CELL_CM = 2;
const SIDE = 64;
export const TILE_CM = CELL_CM * SIDE;
const MAX_TILES = 1500; // 2400 square metres, some 30 MB
const MAX_RAY_CM = 200; // sensors reach 80 cm; a ray longer than this is a jump or wrong, and only its end counts
const FREE = -2;
const OCCUPIED = 14;
const LIMIT = 100;

export class Grid {
  constructor() {
    this.clear();
    this.colours = { free: [255, 255, 255], wall: [44, 54, 70] };
  }
  clear() {
    this.tiles = new Map();
  }
  recolour(colours) {
    this.colours = colours;
    for (const tile of this.tiles.values()) tile.isDirty = true;
  }

  tile(column, row) {
    const key = column * 65536 + row;
    let tile = this.tiles.get(key);
    if (!tile && this.tiles.size < MAX_TILES) {
      tile = { column, row, cells: new Int8Array(SIDE * SIDE), isDirty: true, picture: null };
      this.tiles.set(key, tile);
    }
    return tile;
  }
  add(cellX, cellY, change) {
    const tile = this.tile(cellX >> 6, cellY >> 6);
    if (!tile) return;
    const at = (cellY & 63) * SIDE + (cellX & 63);
    tile.cells[at] = Math.max(-LIMIT, Math.min(LIMIT, tile.cells[at] + change));
    tile.isDirty = true;
  }

  // Adds a ray from the robot to an obstacle, in cm; `worth` 0..1.
  ray(fromX, fromY, toX, toY, worth) {
    let x = Math.floor(fromX / CELL_CM);
    let y = Math.floor(fromY / CELL_CM);
    const endX = Math.floor(toX / CELL_CM);
    const endY = Math.floor(toY / CELL_CM);
    if (Math.hypot(toX - fromX, toY - fromY) <= MAX_RAY_CM) {
      const dx = Math.abs(endX - x);
      const dy = -Math.abs(endY - y);
      let error = dx + dy;
      while (x !== endX || y !== endY) { // Bresenham
        this.add(x, y, FREE);
        const twice = 2 * error;
        if (twice >= dy) { error += dy; x += Math.sign(endX - x); }
        if (twice <= dx) { error += dx; y += Math.sign(endY - y); }
      }
    }
    this.add(endX, endY, Math.round(OCCUPIED * worth));
  }

  paint(tile) {
    tile.picture ??= new OffscreenCanvas(SIDE, SIDE);
    const context = tile.picture.getContext('2d');
    const image = context.createImageData(SIDE, SIDE);
    const [free, wall] = [this.colours.free, this.colours.wall];
    for (let row = 0; row < SIDE; row++) {
      for (let column = 0; column < SIDE; column++) {
        const value = tile.cells[row * SIDE + column];
        if (value === 0) continue;
        const out = ((SIDE - 1 - row) * SIDE + column) * 4; // y points up in the room
        const colour = value > 0 ? wall : free;
        image.data[out] = colour[0];
        image.data[out + 1] = colour[1];
        image.data[out + 2] = colour[2];
        image.data[out + 3] = value > 0 ? 30 + Math.min(150, value * 2.4) : Math.min(255, 60 - value * 12);
      }
    }
    context.putImageData(image, 0, 0);
    tile.isDirty = false;
  }

  // `view` converts room cm to pixels; its `scale` is pixels a cm.
  draw(context, view, width, height) {
    const size = TILE_CM * view.scale;
    context.imageSmoothingEnabled = view.scale * CELL_CM < 2;
    for (const tile of this.tiles.values()) {
      const left = view.px(tile.column * TILE_CM);
      const top = view.py((tile.row + 1) * TILE_CM);
      if (left > width || top > height || left + size < 0 || top + size < 0) continue;
      if (tile.isDirty) this.paint(tile);
      context.drawImage(tile.picture, left, top, size, size);
    }
  }
}
