// SPDX-License-Identifier: Apache-2.0
// The grid as ROS's map_server reads it (http://wiki.ros.org/map_server): the picture's first line is the upper one, and the origin
// is the pose of its lower left corner.
import assert from 'node:assert/strict';
import { test } from 'node:test';
import { Grid } from '../../web/page/grid.js';
import { rosMap } from '../../web/page/rosmap.js';

test('draws a wall, free cells before it, and unknown cells', () => {
  const grid = new Grid();
  grid.ray(1, 1, 21, 1, 1); // from cell 0 to cell 10
  grid.ray(1, -3, 1, -3, 1); // a wall in the tile below
  const { pgm: [head, pixels], yaml } = rosMap(grid, 'room');
  assert.equal(head, 'P5\n64 128\n255\n');
  assert.equal(pixels.length, 64 * 128);
  const at = (x, y) => pixels[(128 - 1 - y) * 64 + x]; // from the lower left corner
  assert.equal(at(0, 64), 254);
  assert.equal(at(9, 64), 254);
  assert.equal(at(10, 64), 0);
  assert.equal(at(11, 64), 205);
  assert.equal(at(0, 62), 0);
  assert.equal(yaml, 'image: room.pgm\nresolution: 0.02\norigin: [0.00, -1.28, 0.0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n');
});

test('makes no picture of an empty grid, nor of points kilometres apart', () => {
  const grid = new Grid();
  assert.equal(rosMap(grid, 'room'), null);
  grid.ray(0, 0, 0, 0, 1);
  grid.ray(3e6, 3e6, 3e6, 3e6, 1);
  assert.equal(rosMap(grid, 'room'), null);
});
