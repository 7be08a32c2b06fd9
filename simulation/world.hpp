// SPDX-License-Identifier: Apache-2.0
// The walls that a robot drives between and measures. Lengths in centimetres, angles in radians,
// counter-clockwise from +x.
#pragma once

#include <cstdint>

#include "simulation/random.hpp"

namespace slamgw::sim {

struct Place {
  double x_cm = 0;
  double y_cm = 0;
};

class World {
 public:
  enum class Shape : std::uint8_t {
    ring,  ///< the thesis's: 160 cm in diameter around (0, 0)
    room,  ///< an L of 260 x 180 cm, which looks like none of its own mirror images
  };

  explicit World(Shape shape) : shape_(shape) {}

  /// Returns the distance along the ray from `from`, which is inside, to the wall.
  double distance_to_wall(Place from, double angle) const;
  /// Returns true if a robot can stand here: its size keeps its centre 12 cm off the walls.
  bool has_room_for_robot(Place place) const;
  /// Returns the place, or one towards (0, 0) if a robot can't reach it.
  Place nearest_reachable(Place place) const;
  /// Returns the next target of a robot.
  Place choose_target(Random& random) const;

 private:
  Shape shape_;
};

}  // namespace slamgw::sim
