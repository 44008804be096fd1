// Contact on the way back: what its forces, moments and memory pass on of their weights.
//
// The laws that were run at a point are run again on a trace (traced.hpp), which is gone through backwards twice: with the
// weights of the memory after the step and of moments, for the positions at the end, before the solution with the Hessian
// is known, and with those of the forces too, for everything else. Forces by positions at the end are in the Hessian,
// but those by the nodes of rigid bodies.
#pragma once

#include <memory>

#include "gradings.hpp"
#include "touching.hpp"

namespace thinshell {

// How elements pass weights on, by kind.
template <class Element> struct Pull;

// Weights of what points remember.
struct HeldWeights {
  std::vector<double> anchor, load, speed;  // (n, 3), (n), (n)
  Keys keys;                                // of edges: the pairs that they are of

  void resize(std::size_t count) {
    anchor.assign(3 * count, 0.0);
    load.assign(count, 0.0);
    speed.assign(count, 0.0);
  }
  bool any(int k) const {
    return anchor[3 * k] != 0.0 || anchor[3 * k + 1] != 0.0 || anchor[3 * k + 2] != 0.0 || load[k] != 0.0 || speed[k] != 0.0;
  }
};

// Of the triangles of sheets that bend: hinges around each (triangles + 1), what their angles make of its curvature
// (., 3), and its number among those whose stiffness changes in time (shared_element of the record) and among those that
// bend by laws, -1: none.
struct Curving {
  int64_t triangles;
  const int32_t *start, *hinge;
  const double *weight;
  const int32_t *graded, *bent;
};

// Sums over the steps of weights of the record's numbers, element by element, as the record has them (of gels with the
// logarithm of the factor, five each; of bending what its triangles have of stiffness and damping, (., 3, 3) each, and of
// the curvature operator, (., 3): by both, and by laws); empty where nobody wants them.
struct ElementWeights {
  std::vector<double> mass, mass_damping, external, stretch_stiffness, stretch_damping, hats, curve_stiffness, curve_damping,
      operator_stiffness, operator_damping, operator_law, rest_angle, gel, gel_gradient, gel_volume, material_row,
      material_area, sample_area, surface_area, edge_area, edge_square, drag_factor, follower_local;

  explicit ElementWeights() = default;
  ElementWeights(const Record &r, const Curving &c)
      : mass(r.mass_start[r.nodes]), mass_damping(mass), external(3 * (r.nodes + r.yielding)),
        stretch_stiffness(9 * r.triangles), stretch_damping(r.triangles), hats(6 * r.triangles),
        curve_stiffness(9 * c.triangles), curve_damping(curve_stiffness), operator_stiffness(3 * c.start[c.triangles]),
        operator_damping(operator_stiffness), operator_law(operator_stiffness), rest_angle(r.hinges), gel(5 * r.tetrahedra),
        gel_gradient(120 * r.tetrahedra), gel_volume(4 * r.tetrahedra), material_row(r.material_row_start[r.material_laws]),
        material_area(r.material_start[r.material_laws]), sample_area(r.samples),
        surface_area(r.surface_sample_start[r.surfaces]), edge_area(r.edge_start[2 * r.edge_pairs]), edge_square(edge_area),
        drag_factor(r.drags), follower_local(3 * r.followers) {}
};

// Weights of a step: of the residual at all nodes, and sums of those that it passes on, by all (nodes, 3); `numbers`: by
// the columns of the record.
struct StepWeights {
  std::vector<double> residual, end, start, past, numbers;
  bool by_elements = false, by_shapes = false;  // shapes: of bodies at rest
  Curving curving{};
  ElementWeights elements;
  const Gradings *gradings = nullptr;
};

// A number on the active trace.
inline Noted noted(double v) { return Noted::variable(v); }

// Add what the numbers of contact laws that effects add have on a trace, from `first` on, to the columns.
inline void collect_added(const Record &r, Trace &trace, int first, std::vector<double> &numbers) {
  const int count = r.added_number_start[r.added_start[r.contacts + r.surfaces + r.edge_pairs]];
  for (int k = 0; k < count; ++k)
    for (int c = 0; c < r.columns; ++c) numbers[c] += trace.weight(first + k) * r.d_added_number[std::size_t(k) * r.columns + c];
}
inline int note_added(const Record &r, Trace &trace) {
  const int first = trace.size(), count = r.added_number_start[r.added_start[r.contacts + r.surfaces + r.edge_pairs]];
  for (int k = 0; k < count; ++k) trace.variable();
  return first;
}

template <> struct Pull<Contacts> {
  HeldWeights held;               // of the memory after the step, then before it
  std::vector<double> rotation;   // of the bodies' rotations after the step, then before it (contacts, 9)
  std::vector<double> moment;     // of the moments (contacts, 3)

  Pull(Contacts &contacts, const Record &record) : c_(contacts), r_(record) {
    held.resize(r_.samples);
    rotation.assign(9 * r_.contacts, 0.0);
    moment.assign(3 * r_.contacts, 0.0);
  }

  // Note the points of a step from `x_start` to `x`; before the memory goes on.
  void note(const double *x_start, const double *x, const Memory &memory, double dt) {
    points_.clear();
    trace_.clear();
    const Trace::Scope scope(trace_);
    added_ = note_added(r_, trace_);
    c_.each([&](int c, int s) {
      if (c_.acts(c, s)) points_.push_back(point_of(x_start, x, memory, dt, c, s));
    });
  }

  // Pass the weights of memory and moments on to the positions of the samples at the end, and those of forces on rigid
  // bodies, `forces` (nodes, 3), by the stiffness that the Hessian has; where it has these bodies too, to them.
  void to_end(const std::vector<double> &forces, std::vector<double> &end) {
    for (const Point &p : points_) {
      Vec3 arm{};
      if (!c_.gives(p.c)) arm = -matmul(c_.stiffness_[p.s], point(forces.data(), r_.body_node[p.c]));
      if (seed(p, Vec3{})) {
        trace_.sweep(p.first, p.last);
        for (int i = 0; i < 3; ++i) arm[i] += trace_.weight(p.arm[i].at);
      }
      trace_.forget(p.first, p.last);
      for (int a = 0; a < c_.members(p.c); ++a) add(end.data(), c_.member(p.c, p.s, a), c_.share(p.s, a) * arm);
    }
    if (!points_.empty()) trace_.forget(added_, points_.front().first);  // numbers of added laws, on which all add up
  }

  // Pass everything on to the rest. `w.end`: of the bodies' nodes alone that the Hessian does not have; `turned`: of the
  // rotations at the end.
  void to_start(StepWeights &w, std::vector<double> &turned) {
    for (std::size_t k = 0; k < turned.size(); ++k) turned[k] += rotation[k];
    HeldWeights before;
    before.resize(r_.samples);
    std::fill(rotation.begin(), rotation.end(), 0.0);
    for (const Point &p : points_) {
      const int s = p.s, body = r_.body_node[p.c];
      Vec3 force = point(w.residual.data(), body);
      for (int a = 0; a < r_.corners; ++a) force -= c_.weight(s, a) * point(w.residual.data(), c_.node(s, a));
      seed(p, force);
      trace_.sweep(p.first, p.last);
      const auto of = [&](const Noted &n) { return n.at ? trace_.weight(n.at) : 0.0; };
      Vec3 end, start;
      for (int i = 0; i < 3; ++i) {
        end[i] = of(p.arm[i]);
        start[i] = of(p.start[i]);
        before.anchor[3 * s + i] = of(p.anchor[i]);
      }
      if (!c_.gives(p.c)) add(w.end.data(), body, -end);
      add(w.start.data(), body, -start);
      for (int a = 0; a < r_.corners; ++a) add(w.start.data(), c_.node(s, a), c_.weight(s, a) * start);
      before.load[s] = of(p.load);
      before.speed[s] = of(p.speed);
      for (int k = 0; k < 9; ++k) {
        turned[9 * p.c + k] += of(p.turn[k]);
        rotation[9 * p.c + k] += of(p.turn_start[k]);
      }
      for (int k = 0; k < 8; ++k)
        for (int i = 0; i < r_.columns; ++i) w.numbers[i] += of(p.law[k]) * r_.d_law[(8 * std::size_t(p.c) + k) * r_.columns + i];
      if (w.by_elements) w.elements.sample_area[s] += of(p.area);
    }
    if (!points_.empty()) collect_added(r_, trace_, added_, w.numbers);
    held = std::move(before);
  }

 private:
  struct Point {
    int c, s, first, last;
    Noted area, arm[3], start[3], anchor[3], load, speed, turn[9], turn_start[9], law[8];
    Noted force[3], moment[3], load_after, anchor_after[3], speed_after;
  };

  Point point_of(const double *x_start, const double *x, const Memory &memory, double dt, int c, int s) {
    Point p{};
    p.c = c;
    p.s = s;
    p.first = trace_.size();
    const Vec3 arm = c_.arm(x, c, s), start = c_.arm(x_start, c, s);
    Vec<Noted, 3> d, d_start, anchor;
    Mat<Noted, 3, 3> turn, turn_start;
    for (int i = 0; i < 3; ++i) {
      d[i] = p.arm[i] = noted(arm[i]);
      d_start[i] = p.start[i] = noted(start[i]);
      anchor[i] = p.anchor[i] = noted(memory.anchor[3 * s + i]);
    }
    for (int k = 0; k < 9; ++k) {
      turn[k] = p.turn[k] = noted(c_.rotation_[9 * c + k]);
      turn_start[k] = p.turn_start[k] = noted(memory.rotation[9 * c + k]);
    }
    for (int k = 0; k < 8; ++k) p.law[k] = r_.columns ? noted(c_.law(c)[k]) : Noted(c_.law(c)[k]);
    const Noted area = p.area = noted(r_.sample_area[s]);
    p.load = noted(memory.load[s]);
    p.speed = noted(memory.speed[s]);
    const Noted limit = c_.added_[c].bound(p.law[MU], p.load, area, p.speed, added_);
    const Friction<Noted> f = friction_start<Noted>(d_start, turn_start, turn, anchor, limit, c_.shape(c));
    const Pressed<Noted> at = press<Noted>(f, d, turn, area, p.law, c_.shape(c), Contacts::AddedPressure{c_, c, s, added_});
    const Vec<Noted, 3> m = d.cross(at.force);
    for (int i = 0; i < 3; ++i) {
      p.force[i] = at.force[i];
      p.moment[i] = m[i];
    }
    if (at.load.v > 0.0) {
      Vec<Noted, 3> after;
      slide<Noted>(f, d, turn, area, p.law, dt, after, p.speed_after);
      for (int i = 0; i < 3; ++i) p.anchor_after[i] = after[i];
      p.load_after = at.load;
    }
    p.last = trace_.size();
    return p;
  }

  // Give what came of a point its weights; false where all are zero.
  bool seed(const Point &p, const Vec3 &force) {
    bool any = false;
    const auto give = [&](const Noted &n, double weight) {
      if (!n.at || weight == 0.0) return;
      trace_.weight(n.at) += weight;
      any = true;
    };
    for (int i = 0; i < 3; ++i) {
      give(p.force[i], force[i]);
      give(p.moment[i], moment[3 * p.c + i]);
      give(p.anchor_after[i], held.anchor[3 * p.s + i]);
    }
    give(p.load_after, held.load[p.s]);
    give(p.speed_after, held.speed[p.s]);
    return any;
  }

  Contacts &c_;
  const Record &r_;
  Trace trace_;
  std::vector<Point> points_;
  int added_ = 0;
};

// Numbers of a point on the trace; positions at the end only where these are to have weights.
template <class Term> struct Noting {
  using S = Noted;
  using A = Noted;
  const Term &of;
  const Held &held;
  const double *x_start, *law_of;
  int k, first;
  bool with_end, with_numbers;
  mutable Noted load_at, speed_at;

  Noted measured(double at) const { return noted(at); }
  Noted start(std::size_t n) const { return noted(x_start[n]); }
  Noted end(std::size_t, double at) const { return with_end ? noted(at) : Noted(at); }
  Noted law(int i) const { return with_numbers ? noted(law_of[i]) : Noted(law_of[i]); }
  Noted anchor(int i) const { return noted(held.anchor[3 * k + i]); }
  Noted load() const { return load_at = noted(held.load[k]); }
  Noted speed() const { return speed_at = noted(held.speed[k]); }
};

// Points of a contact whose forces are on nodes alone.
template <class Term> struct PullPoints {
  using One = typename Term::template One<Noting<Term>>;
  HeldWeights held;  // of the memory after the step, then before it

  // `d_law`: derivatives of the numbers of its law (8, columns).
  PullPoints(Term &term, const Record &record, const double *d_law) : t_(term), r_(record), d_law_(d_law) {}

  void to_end(std::vector<double> &end) {
    for (const Point &p : points_) {
      if (!p.given.with_end) continue;
      seed(p);
      trace_.sweep(p.first, p.last);
      for (int n = 0; n < count(p); ++n) end[3 * p.one->node(n / 3) + n % 3] += of(p.one->x[n]);
      trace_.forget(p.first, p.last);
    }
    if (!points_.empty()) trace_.forget(added_, points_.front().first);  // numbers of added laws, on which all add up
  }

 protected:
  struct Point {
    int k, first, last;
    Noting<Term> given;
    std::unique_ptr<One> one;
    Noted anchor[3], speed, load;
  };

  void begin() {
    points_.clear();
    trace_.clear();
    added_ = note_added(r_, trace_);
  }
  // Note a point, of which `before` is remembered.
  void take(int k, const double *x, double dt, const Held &before, bool loaded) {
    const Trace::Scope scope(trace_);
    const bool remembers = loaded && held.any(k);
    Point p{k, trace_.size(), 0, {t_, before, t_.x_start_, t_.law_.data(), k, added_, remembers, r_.columns > 0, {}, {}}, {}, {}, {}, {}};
    p.one = std::make_unique<One>(t_, k, x, p.given);
    if (remembers) {
      const Vec<Noted, 3> kept = p.one->slide(dt, p.speed);
      for (int i = 0; i < 3; ++i) p.anchor[i] = kept[i];
      p.load = p.one->step.load[0];
    }
    p.last = trace_.size();
    points_.push_back(std::move(p));
  }
  // `measured(point, of)` takes weights of what was measured at rest.
  template <class M> void to_start(StepWeights &w, HeldWeights &before, M &&measured) {
    for (const Point &p : points_) {
      seed(p);
      for (int n = 0; n < count(p); ++n) {
        const Noted &force = p.one->out[n];
        if (force.at) trace_.weight(force.at) += w.residual[3 * p.one->node(n / 3) + n % 3];
      }
      trace_.sweep(p.first, p.last);
      for (int n = 0; n < count(p); ++n) w.start[3 * p.one->node(n / 3) + n % 3] += of(p.one->x_start[n]);
      for (int i = 0; i < 3; ++i) before.anchor[3 * p.k + i] = of(p.one->anchor[i]);
      before.load[p.k] = of(p.given.load_at);
      before.speed[p.k] = of(p.given.speed_at);
      for (int k = 0; k < 8; ++k)
        for (int c = 0; c < r_.columns; ++c) w.numbers[c] += of(p.one->law[k]) * d_law_[k * r_.columns + c];
      if (w.by_elements) measured(p, [&](const Noted &n) { return of(n); });
    }
    if (!points_.empty()) collect_added(r_, trace_, added_, w.numbers);
  }

  Term &t_;
  const Record &r_;
  const double *d_law_;

 private:
  static int count(const Point &p) { return int(std::size(p.one->out)); }
  double of(const Noted &n) { return n.at ? trace_.weight(n.at) : 0.0; }
  void seed(const Point &p) {
    const auto give = [&](const Noted &n, double weight) {
      if (n.at) trace_.weight(n.at) += weight;
    };
    if (!p.given.with_end) return;
    for (int i = 0; i < 3; ++i) give(p.anchor[i], held.anchor[3 * p.k + i]);
    give(p.load, held.load[p.k]);
    give(p.speed, held.speed[p.k]);
  }
  Trace trace_;
  std::vector<Point> points_;
  int added_ = 0;
};

template <> struct Pull<Surface> : PullPoints<Surface> {
  Pull(Surface &term, const Record &record, int which)
      : PullPoints(term, record, record.d_surface_law + 8 * which * record.columns) {
    held.resize(term.samples_);
  }

  void note(const double *x, double dt) {
    begin();
    if (!t_.look(x)) return;
    for (int s = 0; s < t_.samples_; ++s)
      if (t_.acts(s)) take(s, x, dt, t_.held, t_.step_.load[s] > 0.0);
  }
  void to_start(StepWeights &w) {
    HeldWeights before;
    before.resize(t_.samples_);
    PullPoints::to_start(w, before, [&](const Point &p, auto &&of) {
      w.elements.surface_area[t_.first_sample_ + p.k] += of(p.one->area);
    });
    held = std::move(before);
  }
};

template <> struct Pull<EdgePairs> : PullPoints<EdgePairs> {
  Pull(EdgePairs &term, const Record &record, int which)
      : PullPoints(term, record, record.d_edge_law + 8 * which * record.columns) {}

  void note(const double *x, double dt) {
    begin();
    const bool any = t_.look(x);
    const Keys &now = t_.candidates_.inner();
    HeldWeights own;  // of the candidates, from those of the pairs that were remembered
    own.resize(now.size());
    match(held.keys, now, [&](int from, int to) { copy(held, from, own, to); });
    held = std::move(own);
    for (int k = 0; any && k < t_.count(); ++k)
      if (t_.acts(k)) take(k, x, dt, t_.start_, t_.step_.load[k] > 0.0);
  }
  void to_start(StepWeights &w) {
    HeldWeights of_candidates, before;
    const Keys &now = t_.candidates_.inner();
    of_candidates.resize(now.size());
    PullPoints::to_start(w, of_candidates, [&](const Point &p, auto &&of) {
      const auto [i, j] = t_.edges_of(now[p.k]);
      const double area = of(p.one->area), parallel = of(p.one->parallel) * EdgePairs::parallel_edges;
      const bool both = !(r_.edge_area[j] < 0.0);
      w.elements.edge_area[i] += (both ? 0.5 : 1.0) * area;
      if (both) w.elements.edge_area[j] += 0.5 * area;
      w.elements.edge_square[i] += parallel * r_.edge_square[j];
      w.elements.edge_square[j] += parallel * r_.edge_square[i];
    });
    before.keys = t_.keys;
    before.resize(before.keys.size());
    match(now, before.keys, [&](int from, int to) { copy(of_candidates, from, before, to); });
    held = std::move(before);
  }

 private:
  static void copy(const HeldWeights &from, int k, HeldWeights &to, int m) {
    std::copy_n(&from.anchor[3 * k], 3, &to.anchor[3 * m]);
    to.load[m] = from.load[k];
    to.speed[m] = from.speed[k];
  }
  // Pairs that are in both of two sorted lists.
  template <class F> static void match(const Keys &one, const Keys &other, F &&f) {
    for (std::size_t i = 0, k = 0; i < one.size() && k < other.size();)
      if (one[i] < other[k])
        ++i;
      else if (other[k] < one[i])
        ++k;
      else
        f(int(i++), int(k++));
  }
};

}  // namespace thinshell
