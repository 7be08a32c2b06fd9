// SPDX-License-Identifier: Apache-2.0
// One robot in its world and its messages about it. No transport here: both sides of the simulator
// send these bytes. Updates depend on the settings, the seed and the robot's number only, never on
// time, other robots or the mesh.
#pragma once

#include <cstdint>
#include <vector>

#include "simulation/bytes.hpp"
#include "simulation/random.hpp"
#include "simulation/time.hpp"
#include "simulation/world.hpp"

namespace slamgw::sim {

struct BodySettings {
  enum class Model : std::uint8_t {
    usual,   ///< drives in arcs; x = cos, y = sin; rounds; sees up to 80 cm
    thesis,  ///< as listed in thesis 6.3 and described in 4.1: see README.md
  };
  enum class Payload : std::uint8_t {
    positions,  ///< thesis 6.3: `x y (ox oy)*n g`
    full,       ///< of the robots before the thesis: type, x, y, heading, tower, four readings
    probe,      ///< sequence number and the sender's milliseconds
  };
  Model model = Model::usual;
  World::Shape world = World::Shape::ring;
  Payload payload = Payload::positions;
  unsigned max_obstacles = 4;  ///< 0-4; obstacles of later sensors are omitted
  bool has_stray = true;       ///< the octet that real robots append
  bool stands = false;         ///< never leaves its start; the tower turns
  bool is_mirrored = false;    ///< thesis: pose and obstacles count angles differently
};

/// A robot with four infrared distance sensors 90 degrees apart on a tower that turns between 0 and
/// 90 degrees.
class RobotBody {
 public:
  /// `number` counts from 1.
  RobotBody(std::uint64_t seed, unsigned number, const BodySettings& settings = {});

  /// The first message of a robot (`adv`), 6 octets: number (u16 LE), width, length, distance of
  /// the tower from the front and from the side (cm). Never 4n octets, which old servers would draw
  /// as positions.
  Bytes introduction() const;
  bool introduces_itself() const { return settings_.payload != BodySettings::Payload::probe; }

  /// The robot's `count`-th message (from 1), `age` after its start: an update, or a probe of 6
  /// octets, count (u16 LE) and age in milliseconds (u32 LE); both wrap.
  Bytes next_message(std::uint64_t count, Duration age);

  /// Moves by one step (200 ms of the robot's time); returns `x y (ox oy)*n g`, int16 LE in
  /// cm, n = 0..4, and the stray byte g that robots append (thesis 6.3: the struct is cut short).
  /// Full payload: 01, x, y, heading, tower (int16 LE, cm and degrees), four readings (u8, cm).
  Bytes next_update();

  /// Commands. They change later updates, so they are used on request only (--obey).
  void head_for(std::int16_t x_cm, std::int16_t y_cm);
  void set_running(bool is_running) { is_running_ = is_running; }

 private:
  bool is_thesis() const { return settings_.model == BodySettings::Model::thesis; }
  bool is_compass() const { return is_thesis() && !settings_.is_mirrored; }
  void move_usual();
  void move_thesis();
  void drive(double step_cm);
  double turn_to_target() const;
  double beam_angle(unsigned sensor) const;
  long read_usual(unsigned sensor);
  long read_thesis(unsigned sensor);
  void append_obstacle(Bytes& out, unsigned sensor, long reading_cm) const;
  void append_point(Bytes& out, double x_cm, double y_cm) const;
  Bytes positions(const std::vector<long>& readings_cm);
  Bytes full(const std::vector<long>& readings_cm) const;

  BodySettings settings_;
  World world_;
  Random random_;
  unsigned number_;
  Place place_{};
  double heading_rad_ = 0;
  Place target_{};
  int tower_degrees_ = 0;
  int tower_step_degrees_ = 5;
  bool is_running_ = true;
};

}  // namespace slamgw::sim
