// SPDX-License-Identifier: Apache-2.0
// The world of one robot: the thesis's test ring and what the robot says about it. No transport
// here: both sides of the simulator carry these bytes. They depend on the seed and the robot's
// number only, never on time, other robots or the mesh.
#pragma once

#include <cstdint>

#include "simulation/bytes.hpp"
#include "simulation/random.hpp"

namespace slamgw::sim {

/// A robot in a ring of 160 cm diameter around (0, 0), with four infrared distance sensors 90
/// degrees apart on a tower that turns between 0 and 90 degrees.
class RobotBody {
 public:
  /// `number` counts from 1.
  RobotBody(std::uint64_t seed, unsigned number);

  /// The first message of a robot (`adv`), 6 octets: number (u16 LE), width, length, distance of
  /// the tower from the front and from the side (cm). Never 4n octets, which old servers would draw
  /// as positions.
  Bytes introduction() const;

  /// Moves on by one step (200 ms of the robot's time) and tells: `x y (ox oy)*n g`, int16 LE in
  /// cm, n = 0..4, and the stray byte g that robots append (thesis 6.3: the struct is cut short).
  Bytes next_update();

  /// Commands. They change what later updates say, so they are used on request only (--obey).
  void head_for(std::int16_t x_cm, std::int16_t y_cm);
  void set_running(bool is_running) { is_running_ = is_running; }

 private:
  void choose_target();
  void move();
  void append_obstacle(Bytes& out, unsigned sensor);

  Random random_;
  unsigned number_;
  double x_cm_ = 0;
  double y_cm_ = 0;
  double heading_rad_ = 0;
  double target_x_cm_ = 0;
  double target_y_cm_ = 0;
  int tower_degrees_ = 0;
  int tower_step_degrees_ = 5;
  bool is_running_ = true;
};

}  // namespace slamgw::sim
