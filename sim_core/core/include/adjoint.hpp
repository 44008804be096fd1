// The way back through a rollout: weights of a sum of readings (its derivatives) by everything that the rollout depends on.
//
// A step solves R(x'; s, p) = 0 from the state s, with its memory, by numbers p, where what is prescribed is at m. With the
// weights x_bar of x', and w of the loads -R on what is held, and H the Hessian (docs/design/gradients.md):
//
//     lambda = -H^-1 (x_bar - H w),    y = lambda - w,    m_bar = x_bar + H y,    s_bar = dR/ds^T y,    p_bar += dR/dp^T y
//
// where x_bar includes what the velocity and the memory after the step pass on, and s_bar, p_bar what memory and moments
// do (contact_pull.hpp, elements_pull.hpp). States are those of a tape; nothing is searched for.
#pragma once

#include "elements_pull.hpp"
#include "rollout.hpp"

namespace thinshell {

inline std::size_t Tape::Kept::bytes() const {
  std::size_t count = x.size() + v.size() + v_past.size() + places.size() + from.size() + to.size() + rotation.size() + bonded.size();
  const auto add = [&](const Points &p) { count += p.which.size() + p.held.size(); };
  add(shapes);
  for (const Points &p : others) add(p);
  for (const Numbers &k : keys) count += k.size();
  for (const Values &m : materials) count += m.size();
  return sizeof(Kept) + 8 * count;
}

inline void Tape::take(Rollout &rollout, double dt, const Frames &frames, bool inertia) {
  const auto points = [](const Values &anchor, const Values &load, const Values &speed) {
    Points out;
    for (std::size_t k = 0; k < load.size(); ++k)
      if (load[k] != 0.0) {
        out.which.push_back(int64_t(k));
        out.held.insert(out.held.end(), {anchor[3 * k], anchor[3 * k + 1], anchor[3 * k + 2], load[k], speed[k]});
      }
    return out;
  };
  const Record &r = rollout.record();
  Kept kept{};
  kept.whole = true;
  kept.interval = interval;
  kept.share = share;
  kept.dt = dt;
  kept.since = rollout.has_past ? rollout.dt_past : 0.0;
  kept.start = rollout.time[0];
  kept.inertia = inertia;
  kept.x = rollout.x;
  kept.v = rollout.velocity();
  kept.places.assign(frames.places, frames.places + 12 * r.mounts);
  if (share < 1.0) {
    kept.from.assign(from, from + 12 * r.mounts);
    kept.to.assign(to, to + 12 * r.mounts);
  }
  const Memory &m = rollout.memory;
  kept.rotation = m.rotation;
  kept.shapes = points(m.anchor, m.load, m.speed);
  for (std::size_t k = 0; k < m.bonded.size(); ++k)
    if (m.bonded[k] != 0.0) kept.bonded.push_back(int64_t(k));
  auto &contacts = rollout.system.contacts;
  for (const Surface &s : contacts.surfaces) kept.others.push_back(points(s.held.anchor, s.held.load, s.held.speed));
  for (const EdgePairs &e : contacts.edges) {
    kept.others.push_back(points(e.held.anchor, e.held.load, e.held.speed));
    kept.keys.push_back(e.keys);
  }
  for (int k = 0; k < r.material_laws; ++k) kept.materials.push_back(rollout.system.material(k, false));
  last = rollout.system.x;
  bytes_ += kept.bytes();
  steps.push_back(std::move(kept));
  while (bound > 0 && bytes_ > bound && thin()) {
  }
}

inline bool Tape::thin() {
  // The steps of settling, the first one after them and the last one stay whole, and so does each `stride_`-th.
  const auto drop = [&](std::size_t k) {
    Kept &kept = steps[k];
    if (!kept.whole || kept.interval == 0 || k % stride_ == 0 || (k && steps[k - 1].interval == 0)) return false;
    if (Kept &next = steps[k + 1]; next.whole && next.since > 0.0) {
      next.v_past = kept.v;
      bytes_ += 8 * next.v_past.size();
    }
    bytes_ -= kept.bytes();
    Kept less{};
    less.interval = kept.interval;
    less.share = kept.share;
    less.dt = kept.dt;
    less.inertia = kept.inertia;
    less.whole = false;
    less.x = std::move(kept.x);
    less.places = std::move(kept.places);
    less.from = std::move(kept.from);
    less.to = std::move(kept.to);
    kept = std::move(less);
    bytes_ += kept.bytes();
    return true;
  };
  bool dropped = false;
  for (; thinned_ + 1 < steps.size() && bytes_ > bound; ++thinned_) dropped = drop(thinned_) || dropped;
  if (dropped || 2 * stride_ > steps.size()) return dropped;
  stride_ *= 2;
  thinned_ = 0;
  return true;
}

inline void Tape::restore(std::size_t k, Rollout &rollout) const {
  const auto put = [](const Points &points, Values &anchor, Values &load, Values &speed) {
    for (Values *v : {&anchor, &load, &speed}) std::fill(v->begin(), v->end(), 0.0);
    for (std::size_t k = 0; k < points.which.size(); ++k) {
      const double *from = &points.held[5 * k];
      const std::size_t at = points.which[k];
      std::copy(from, from + 3, &anchor[3 * at]);
      load[at] = from[3];
      speed[at] = from[4];
    }
  };
  const Kept &kept = steps[k];
  rollout.x = kept.x;
  rollout.velocity() = kept.v;
  rollout.has_past = kept.since > 0.0;
  rollout.dt_past = kept.since;
  rollout.time[0] = kept.start;
  if (rollout.has_past) {
    rollout.x_past = steps[k - 1].x;
    rollout.v_past = kept.v_past.empty() ? steps[k - 1].v : kept.v_past;
  }
  Memory &m = rollout.memory;
  m.rotation = kept.rotation;
  put(kept.shapes, m.anchor, m.load, m.speed);
  std::fill(m.bonded.begin(), m.bonded.end(), 0.0);
  for (int64_t at : kept.bonded) m.bonded[at] = 1.0;
  auto &contacts = rollout.system.contacts;
  std::size_t other = 0, edges = 0;
  for (Surface &s : contacts.surfaces) put(kept.others[other++], s.held.anchor, s.held.load, s.held.speed);
  for (EdgePairs &e : contacts.edges) {
    e.keys = kept.keys[edges++];
    e.held.resize(e.keys.size(), std::size_t(rollout.record().columns));
    put(kept.others[other++], e.held.anchor, e.held.load, e.held.speed);
  }
  for (std::size_t law = 0; law < kept.materials.size(); ++law) rollout.system.material(int(law), false) = kept.materials[law];
}

// Weights of readings at some instants, from `first` on; null: none.
struct ReadingWeights {
  int64_t first;
  const double *x, *force, *moment;  // (., nodes and deflections, 3), of the loads (., bearing, 3), moments (., contacts, 3)
};

class Adjoint {
 public:
  explicit Adjoint(const Record &record)
      : r_(record), rollout_(record, 0), shapes_(system().contacts.shapes, r_),
        triangles_(system().triangles, r_), hinges_(system().hinges, r_), tetrahedra_(system().tetrahedra, r_),
        drag_(system().drag, r_), applied_(system().loads, r_), yielding_(system().yielding, r_) {
    const std::size_t whole = system().whole();
    for (Values *v : {&x, &v_, &x_past_, &v_past_, &w_.residual, &w_.end, &w_.start, &w_.past}) v->assign(whole, 0.0);
    w_.numbers.assign(r_.columns, 0.0);
    w_.gradings = &rollout_.gradings_;
    for (Surface &s : system().contacts.surfaces) surfaces_.emplace_back(s, r_, int(surfaces_.size()));
    for (EdgePairs &e : system().contacts.edges) edges_.emplace_back(e, r_, int(edges_.size()));
    turned_.assign(9 * r_.contacts, 0.0);
  }
  Adjoint(const Adjoint &) = delete;

  // Through the steps of a tape to instants from `from` on, the last one first; those to later instants were gone through.
  // `frames`: weights of motions of the mounts in their own frames (instants, mounts, 6), added to.
  void sweep(const Tape &tape, int64_t from, const ReadingWeights &readings, double *frames) {
    for (; at_ > 0 && tape.steps[at_ - 1].interval >= from; --at_) {
      const Tape::Kept &kept = tape.steps[at_ - 1];
      const bool last = at_ == tape.steps.size() || tape.steps[at_].interval != kept.interval;
      back(tape, at_ - 1, last ? readings : ReadingWeights{0, nullptr, nullptr, nullptr}, frames);
    }
  }

  // Begin at the end of a tape, all weights zero.
  void begin(const Tape &tape) {
    at_ = tape.steps.size();
    again_.steps.clear();
    for (Values *v : {&x, &v_, &x_past_, &v_past_, &w_.numbers, &shapes_.rotation}) std::fill(v->begin(), v->end(), 0.0);
    if (w_.by_elements) w_.elements = ElementWeights(r_, w_.curving);
    forget();
  }

  // Back from forces where nothing has moved yet (Rollout::stand), in the state that was written into the rollout.
  void stand(double dt, const double *places, bool inertia, const ReadingWeights &readings, double *frames) {
    const Frames there{places, nullptr, nullptr};
    rollout_.has_past = false;
    rollout_.time[0] = -dt;
    rollout_.place(there);
    rollout_.begin(dt, inertia);
    system().x = rollout_.x;
    system().cover();
    system().residual();
    system().assemble(true, nullptr);
    read(readings, 0);
    for (Values *v : {&w_.end, &w_.start, &w_.past}) std::fill(v->begin(), v->end(), 0.0);
    w_.residual = loads_;
    forget();  // nothing is remembered yet
    std::fill(turned_.begin(), turned_.end(), 0.0);
    Values rotation(shapes_.rotation.size(), 0.0);
    rotation.swap(shapes_.rotation);
    system().hessian.multiply(loads_.data(), w_.end.data(), 1);
    shapes_.note(rollout_.x.data(), system().x.data(), rollout_.memory, dt);
    for (auto &pull : surfaces_) pull.note(system().x.data(), dt);
    for (auto &pull : edges_) pull.note(system().x.data(), dt);
    shapes_.to_end(loads_, w_.end);
    Values v_base(system().whole(), 0.0);
    pass_on_inertia(v_base);
    shapes_.to_start(w_, turned_);
    for (auto &pull : surfaces_) pull.to_start(w_);
    for (auto &pull : edges_) pull.to_start(w_);
    drag_.to_start(system().x.data(), rollout_.x.data(), w_);
    applied_.to_start(system().x.data(), w_);
    triangles_.to_start(system().x.data(), rollout_.x.data(), nullptr, w_);
    hinges_.to_start(system().x.data(), rollout_.x.data(), nullptr, w_);
    tetrahedra_.to_start(system().x.data(), rollout_.x.data(), nullptr, w_);
    for (std::size_t k = 0; k < x.size(); ++k) {
      x[k] += w_.end[k] + w_.start[k];
      v_[k] += v_base[k];
    }
    for (std::size_t k = 0; k < rotation.size(); ++k) shapes_.rotation[k] += rotation[k];
    std::fill(w_.end.begin(), w_.end.end(), 0.0);  // positions are those of the start
    drive(places, nullptr, frames);
  }

  Rollout &rollout() { return rollout_; }
  std::vector<double> &material(int law) {
    for (auto *found : {triangles_.laws.of(law), hinges_.laws.of(law)})
      if (found) return *found;
    return *tetrahedra_.laws.of(law);
  }
  HeldWeights &held(int term) {
    if (term < 0) return shapes_.held;
    return term < int(surfaces_.size()) ? surfaces_[term].held : edges_[term - surfaces_.size()].held;
  }
  std::vector<double> &rotation() { return shapes_.rotation; }
  std::vector<double> &velocity() { return v_; }
  std::vector<double> &numbers() { return w_.numbers; }
  // Sum up weights element by element from `begin` on; `shapes`: those by what is measured at rest, too.
  void want_elements(const Curving &curving, bool shapes) {
    w_.by_elements = true;
    w_.by_shapes = shapes;
    w_.curving = curving;
  }
  ElementWeights &elements() { return w_.elements; }

  Values x;  // weights of the positions

 private:
  System &system() { return rollout_.system; }
  static void clear(HeldWeights &held) {
    for (Values *v : {&held.anchor, &held.load, &held.speed}) std::fill(v->begin(), v->end(), 0.0);
  }
  // Let no weight be left of what is remembered.
  void forget() {
    clear(shapes_.held);
    for (auto &s : surfaces_) clear(s.held);
    for (auto &e : edges_) e.held = HeldWeights{};
    for (int law = 0; law < r_.material_laws; ++law) std::fill(material(law).begin(), material(law).end(), 0.0);
  }

  // Add the weights of readings at an instant to those of the state, and take those of loads and moments.
  void read(const ReadingWeights &readings, int64_t instant) {
    loads_.assign(system().whole(), 0.0);
    std::fill(shapes_.moment.begin(), shapes_.moment.end(), 0.0);
    bears_ = false;
    if (!readings.x) return;
    const int64_t row = instant - readings.first;
    for (std::size_t k = 0; k < x.size(); ++k) x[k] += readings.x[row * x.size() + k];
    for (int b = 0; b < r_.bearing; ++b)
      for (int i = 0; i < 3; ++i) {
        const double w = readings.force[(row * r_.bearing + b) * 3 + i];
        loads_[3 * r_.bearing_node[b] + i] -= w;
        bears_ = bears_ || w != 0.0;
      }
    const Values own = loads_;  // of what is embedded, apart from the load that it passes on to others
    system().embedding.fill(loads_.data());
    for (int e = 0; e < r_.embedded; ++e)
      for (int i = 3 * r_.embedded_node[e]; i < 3 * r_.embedded_node[e] + 3; ++i) loads_[i] += own[i];
    for (std::size_t k = 0; k < shapes_.moment.size(); ++k) shapes_.moment[k] = readings.moment[row * shapes_.moment.size() + k];
  }

  // Bring the rollout to the start of a step, made again from the last one before it that was kept whole.
  void enter(const Tape &tape, std::size_t k) {
    if (tape.steps[k].whole) {
      tape.restore(k, rollout_);
      return;
    }
    if (again_.steps.empty() || k < again_first_ || k >= again_first_ + again_.steps.size()) {
      again_first_ = k;
      while (!tape.steps[again_first_].whole) --again_first_;
      again_.steps.clear();
      tape.restore(again_first_, rollout_);
      rollout_.tape = &again_;
      for (std::size_t step = again_first_; step <= k; ++step) {
        const Tape::Kept &made = tape.steps[step];
        rollout_.accept(made.dt, {made.places.data(), nullptr, nullptr}, tape.end_of(step).data(), made.inertia);
      }
      rollout_.tape = nullptr;
    }
    again_.restore(k - again_first_, rollout_);
  }

  void back(const Tape &tape, std::size_t k, const ReadingWeights &readings, double *frames) {
    const Tape::Kept &kept = tape.steps[k];
    enter(tape, k);
    read(readings, kept.interval);
    if (kept.interval == 0) {  // each step of settling begins at rest
      for (Values *v : {&v_, &x_past_, &v_past_}) std::fill(v->begin(), v->end(), 0.0);
    }
    System &s = system();
    const Frames there{kept.places.data(), nullptr, nullptr};
    rollout_.place(there);
    rollout_.begin(kept.dt, kept.inertia);
    s.x = tape.end_of(k);
    s.cover();
    s.residual();
    s.assemble(true, nullptr);
    if (!s.factorise(true)) s.factorise(false);  // need not be definite where motion holds it
    const Step &step = rollout_.step_;
    const double *now = s.x.data(), *start = rollout_.x.data(), *past = rollout_.has_past ? rollout_.x_past.data() : nullptr;

    w_.end = x;
    if (kept.inertia)
      for (std::size_t i = 0; i < x.size(); ++i) w_.end[i] += v_[i] / step.tau;
    if (bears_) s.hessian.multiply(loads_.data(), w_.end.data(), 1);
    shapes_.note(start, now, rollout_.memory, kept.dt);
    for (auto &pull : surfaces_) pull.note(now, kept.dt);
    for (auto &pull : edges_) pull.note(now, kept.dt);
    shapes_.to_end(loads_, w_.end);
    for (auto &pull : surfaces_) pull.to_end(w_.end);
    for (auto &pull : edges_) pull.to_end(w_.end);
    triangles_.to_end(now, w_.end);
    hinges_.to_end(now, w_.end);
    tetrahedra_.to_end(now, w_.end);
    s.fold(w_.end.data());
    Values moved = s.picked(w_.end);
    s.factor.solve(moved.data());
    for (double &m : moved) m = -m;
    Values multiplier = s.spread(moved), held(x.size(), 0.0);
    s.hessian.multiply(multiplier.data(), held.data(), 1);
    s.embedding.fold(held.data());
    for (std::size_t i = 0; i < x.size(); ++i) {
      w_.end[i] += held[i];
      w_.residual[i] = multiplier[i] + loads_[i];
    }

    for (Values *v : {&w_.start, &w_.past}) std::fill(v->begin(), v->end(), 0.0);
    std::fill(turned_.begin(), turned_.end(), 0.0);
    Values base(x.size(), 0.0), v_base(x.size(), 0.0);
    w_.start.swap(base);
    pass_on_inertia(v_base);
    w_.start.swap(base);
    if (kept.inertia)
      for (std::size_t i = 0; i < x.size(); ++i) base[i] -= v_[i] / step.tau;
    shapes_.to_start(w_, turned_);
    for (auto &pull : surfaces_) pull.to_start(w_);
    for (auto &pull : edges_) pull.to_start(w_);
    triangles_.to_start(now, start, past, w_);
    hinges_.to_start(now, start, past, w_);
    tetrahedra_.to_start(now, start, past, w_);
    drag_.to_start(now, start, w_);
    applied_.to_start(now, w_);
    yielding_.to_start(now, w_);

    const double own = past ? step.now : 1.0, before = past ? step.before : 0.0;
    for (std::size_t i = 0; i < x.size(); ++i) {
      x[i] = own * base[i] + w_.start[i] + x_past_[i];
      v_[i] = own * v_base[i] + v_past_[i];
      x_past_[i] = before * base[i] + w_.past[i];
      v_past_[i] = before * v_base[i];
    }
    drive(kept.places.data(), &kept, frames);
  }

  // What inertia, damping by mass and loads pass on of the weights of the residual: to what velocity and acceleration are
  // measured from, positions (`w_.start`) and velocities, and to numbers.
  void pass_on_inertia(Values &v_base) {
    const Step &step = rollout_.step_;
    const double factor = system().pull(), tau = step.tau;
    const Values &y = w_.residual, &now = system().x;
    const int entries = r_.mass_start[r_.nodes];
    for (int i = 0; i < r_.nodes; ++i)
      for (int k = r_.mass_start[i]; k < r_.mass_start[i + 1]; ++k) {
        const int j = r_.mass_column[k];
        const double pull = factor * r_.mass[k], rub = r_.mass_damping[k] / tau;
        for (int a = 0; a < 3; ++a) {
          const double own = y[3 * i + a];
          w_.start[3 * j + a] -= (pull + rub) * own;
          v_base[3 * j + a] -= pull * tau * own;
          if (!r_.mass_blocks && !w_.by_elements) continue;
          const double since = now[3 * j + a] - step.x_base[3 * j + a];
          const double accelerated = factor * (since - tau * step.v_base[3 * j + a]);
          if (w_.by_elements) {
            w_.elements.mass[k] += own * accelerated;
            w_.elements.mass_damping[k] += own * since / tau;
          }
          for (int m = 0; m < r_.mass_blocks; ++m)
            w_.numbers[r_.mass_of[m]] +=
                own * (r_.d_mass[m * entries + k] * accelerated + r_.d_mass_damping[m * entries + k] * since / tau);
        }
      }
    for (std::size_t k = 0; w_.by_elements && k < y.size(); ++k) w_.elements.external[k] -= y[k];
    for (std::size_t k = 0; k < y.size(); ++k)
      for (int c = 0; c < r_.columns; ++c) w_.numbers[c] -= r_.d_external[k * r_.columns + c] * y[k];
  }

  // From weights of where followers and rigid bodies are to those of motions of the mounts.
  void drive(const double *places, const Tape::Kept *kept, double *frames) {
    Values motion(6 * r_.mounts, 0.0);
    for (int f = 0; f < r_.followers; ++f) {
      const int node = r_.follower_node[f], mount = r_.follower_mount[f];
      Vec3 force{};
      for (int i = 0; i < 3; ++i)
        if (r_.follower_axes[3 * f + i] && r_.prescribed[3 * node + i]) force[i] = w_.end[3 * node + i];
      const Vec3 own = matmul(rotation_of(places + 12 * mount + 3).transpose(), force);
      push(motion, mount, own, Vec3(point(r_.follower_local, f).cross(own)));
      for (int i = 0; w_.by_elements && i < 3; ++i) w_.elements.follower_local[3 * f + i] += own[i];
    }
    for (int b = 0; b < r_.contacts; ++b) {
      const int mount = r_.body_mount[b];
      const Mat3 turn = rotation_of(places + 12 * mount + 3), own = rotation_of(r_.body_rotation + 9 * b);
      const Mat3 m = matmul(matmul(turn.transpose(), rotation_of(&turned_[9 * b])), own.transpose());
      push(motion, mount, Vec3{}, Vec3{{m(2, 1) - m(1, 2), m(0, 2) - m(2, 0), m(1, 0) - m(0, 1)}});
    }
    const int64_t at = kept ? kept->interval : 0;
    double *there = frames + at * motion.size();
    if (!kept || kept->share == 1.0) {
      for (std::size_t k = 0; k < motion.size(); ++k) there[k] += motion[k];
      return;
    }
    for (int m = 0; m < r_.mounts; ++m) {  // the transpose of Rollout::moved_between
      const MotionBetween by = motion_between(&kept->from[12 * m + 3], &kept->to[12 * m + 3], kept->share);
      const auto add = [&](const Mat3 &factor, double *to, int part) {
        for (int i = 0; i < 3; ++i)
          for (int j = 0; j < 3; ++j) to[6 * m + part + j] += factor(i, j) * motion[6 * m + part + i];
      };
      add(by.shift_from, there - motion.size(), 0);
      add(by.shift_to, there, 0);
      add(by.turn_from, there - motion.size(), 3);
      add(by.turn_to, there, 3);
    }
  }
  static void push(Values &motion, int mount, const Vec3 &shift, const Vec3 &turn) {
    for (int i = 0; i < 3; ++i) {
      motion[6 * mount + i] += shift[i];
      motion[6 * mount + 3 + i] += turn[i];
    }
  }

  const Record r_;
  Rollout rollout_;
  Pull<Contacts> shapes_;
  std::deque<Pull<Surface>> surfaces_;
  std::deque<Pull<EdgePairs>> edges_;
  Pull<Triangles> triangles_;
  Pull<Hinges> hinges_;
  Pull<Tetrahedra> tetrahedra_;
  Pull<Drag> drag_;
  Pull<Loads> applied_;
  Pull<Yielding> yielding_;
  StepWeights w_;
  Values v_, x_past_, v_past_, loads_, turned_;
  bool bears_ = false;
  Tape again_;  // steps that were made again, from the step `again_first_` of the tape on
  std::size_t again_first_ = 0;
  std::size_t at_ = 0;  // steps that are still to be gone through
};

}  // namespace thinshell
