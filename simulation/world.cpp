// SPDX-License-Identifier: Apache-2.0
#include "simulation/world.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>

namespace slamgw::sim {
namespace {

constexpr double ring_radius_cm = 80;
constexpr double clearance_cm = 12;
constexpr double roaming_radius_cm = ring_radius_cm - clearance_cm;

/// Counter-clockwise; the upper right quarter is missing.
constexpr std::array<Place, 6> room_corners{
    {{-150, -90}, {110, -90}, {110, 10}, {30, 10}, {30, 90}, {-150, 90}}};

double distance_to_ring(Place from, double angle) {
  const double along = from.x_cm * std::cos(angle) + from.y_cm * std::sin(angle);
  return std::sqrt(along * along + ring_radius_cm * ring_radius_cm - from.x_cm * from.x_cm -
                   from.y_cm * from.y_cm) -
         along;
}

/// Returns the distance along the ray to the wall from `a` to `b`; infinite when the ray misses it.
double distance_to_segment(Place from, double angle, Place a, Place b) {
  const double dx = std::cos(angle);
  const double dy = std::sin(angle);
  const double ex = b.x_cm - a.x_cm;
  const double ey = b.y_cm - a.y_cm;
  const double determinant = ex * dy - ey * dx;
  if (std::abs(determinant) < 1e-9) return std::numeric_limits<double>::infinity();
  const double ax = a.x_cm - from.x_cm;
  const double ay = a.y_cm - from.y_cm;
  const double along_ray = (ex * ay - ey * ax) / determinant;
  const double along_wall = (dx * ay - dy * ax) / determinant;
  const bool hits = along_ray >= 0 && along_wall >= 0 && along_wall <= 1;
  return hits ? along_ray : std::numeric_limits<double>::infinity();
}

double distance_in_room(Place from, double angle) {
  double nearest = std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i < room_corners.size(); ++i) {
    const Place next = room_corners[(i + 1) % room_corners.size()];
    nearest = std::min(nearest, distance_to_segment(from, angle, room_corners[i], next));
  }
  return nearest;
}

bool is_clear_in_room(Place place) {
  const bool in_left = place.x_cm >= -150 + clearance_cm && place.x_cm <= 30 - clearance_cm &&
                       place.y_cm >= -90 + clearance_cm && place.y_cm <= 90 - clearance_cm;
  const bool in_bottom = place.x_cm >= -150 + clearance_cm && place.x_cm <= 110 - clearance_cm &&
                         place.y_cm >= -90 + clearance_cm && place.y_cm <= 10 - clearance_cm;
  return in_left || in_bottom;
}

}  // namespace

double World::distance_to_wall(Place from, double angle) const {
  return shape_ == Shape::ring ? distance_to_ring(from, angle) : distance_in_room(from, angle);
}

bool World::has_room_for_robot(Place place) const {
  if (shape_ == Shape::room) return is_clear_in_room(place);
  return std::hypot(place.x_cm, place.y_cm) <= roaming_radius_cm;
}

Place World::nearest_reachable(Place place) const {
  if (shape_ == Shape::ring) {
    const double distance = std::hypot(place.x_cm, place.y_cm);
    const double scale = distance > roaming_radius_cm ? roaming_radius_cm / distance : 1;
    return {place.x_cm * scale, place.y_cm * scale};
  }
  constexpr int steps = 100;
  for (int step = steps; step > 0; --step) {
    const Place nearer{place.x_cm * step / steps, place.y_cm * step / steps};
    if (is_clear_in_room(nearer)) return nearer;
  }
  return {};
}

Place World::choose_target(Random& random) const {
  if (shape_ == Shape::ring) {
    const double radius = roaming_radius_cm * std::sqrt(random.unit());
    const double angle = random.unit() * 2 * std::numbers::pi;
    return {radius * std::cos(angle), radius * std::sin(angle)};
  }
  for (;;) {  // at least a third of the box is valid, so this ends
    const Place place{-150 + 260 * random.unit(), -90 + 180 * random.unit()};
    if (is_clear_in_room(place)) return place;
  }
}

}  // namespace slamgw::sim
