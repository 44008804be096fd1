// Contact of the samples of one surface with the triangles of another, or of its own (sim_core/contact/surface.py).
//
// The kernels of sim_core/contact/surface_kernels.py and surface_geometry.py are run as they are, lowered, over all
// samples; derivatives by parameters are those of the same kernels run with dual numbers over one sample at a time.
#pragma once

#include <set>
#include <vector>

#include "contact.hpp"
#include "neighbours.hpp"

namespace thinshell {

// Gap [m] of what has no candidates (FAR of surface_kernels.py).
constexpr double nowhere = 1e30;

// What the points of a contact remember from one step to the next, with derivatives, columns innermost.
struct Held {
  std::vector<double> anchor, load, speed;        // (n, 3), (n), (n)
  std::vector<double> d_anchor, d_load, d_speed;  // (., columns) each

  void resize(std::size_t count, std::size_t columns) {
    anchor.assign(3 * count, 0.0);
    load.assign(count, 0.0);
    speed.assign(count, 0.0);
    d_anchor.assign(3 * count * columns, 0.0);
    d_load.assign(count * columns, 0.0);
    d_speed.assign(count * columns, 0.0);
  }
  void take(int at, const Held &from, int there, std::size_t columns) {
    auto some = [&](std::vector<double> &to, const std::vector<double> &of, std::size_t width) {
      std::copy_n(of.begin() + there * width, width, to.begin() + at * width);
    };
    some(anchor, from.anchor, 3);
    some(load, from.load, 1);
    some(speed, from.speed, 1);
    some(d_anchor, from.d_anchor, 3 * columns);
    some(d_load, from.d_load, columns);
    some(d_speed, from.d_speed, columns);
  }
};

// Where samples are nearest to triangles, as the kernel `measure` writes it.
template <class S> struct Nearest {
  static constexpr int most = 12;  // triangles that may share in a gap (MOST of surface_kernels.py)
  int count;
  std::vector<int> number, triangle, kind;
  std::vector<S> weight, direction, share, distance, sign, gap;

  explicit Nearest(int samples) : count(samples), number(samples, 0) {
    triangle.assign(most * samples, 0);
    kind.assign(most * samples, 0);
    weight.assign(3 * most * samples, S(0.0));
    direction = weight;
    share.assign(most * samples, S(0.0));
    distance = share;
    sign.assign(samples, S(1.0));
    gap.assign(samples, S(nowhere));
  }
  View<int, 1> numbers() { return {number.data(), count}; }
  View<int, 2> triangles() { return {triangle.data(), count, most}; }
  View<int, 2> kinds() { return {kind.data(), count, most}; }
  View<S, 2> weights() { return {weight.data(), count, 3 * most}; }
  View<S, 2> directions() { return {direction.data(), count, 3 * most}; }
  View<S, 2> shares() { return {share.data(), count, most}; }
  View<S, 2> distances() { return {distance.data(), count, most}; }
  View<S, 1> signs() { return {sign.data(), count}; }
  View<S, 1> gaps() { return {gap.data(), count}; }
};

// Some samples over triangles: their tables, and what the kernels write of them; A: of their areas.
template <class S, class A = double> struct SampleStep {
  View<const int, 2> own;
  View<const int, 1> used;
  View<const double, 2> weights;
  View<const int, 2> triangles, border;
  View<const A, 1> areas;
  int count;
  Nearest<S> now, lag;
  std::vector<S> limit, frame, force, load;
  std::vector<S> added;  // energy, pressure and slope by effects

  SampleStep(View<const int, 2> own_, View<const int, 1> used_, View<const double, 2> weights_,
             View<const int, 2> triangles_, View<const int, 2> border_, View<const A, 1> areas_)
      : own(own_), used(used_), weights(weights_), triangles(triangles_), border(border_), areas(areas_),
        count(own_.shape[0]), now(count), lag(count) {
    limit.assign(count, S(0.0));
    load = limit;
    frame.assign(27 * count, S(0.0));
    force.assign(3 * count, S(0.0));
    added.assign(3 * count, S(0.0));
  }
  View<S, 2> frames() { return {frame.data(), count, 27}; }
  View<const S, 2> added_pressures() const { return {added.data(), count, 3}; }

  template <class X, class L>
  void measure(Nearest<S> &to, X x, View<const int, 1> first, View<const int, 1> near, View<const double, 2> normals,
               View<const double, 1> side, L law) {
    laws::surface_kernels::measure(x, own, used, weights, triangles, border, first, near, normals, side, law, to.numbers(),
                                   to.triangles(), to.weights(), to.directions(), to.shares(), to.kinds(), to.distances(),
                                   to.signs(), to.gaps());
  }
  template <class X> void make_frames(X x_start) {
    laws::surface_geometry::frames(x_start, own, used, weights, triangles, lag.numbers(), lag.triangles(), frames());
  }
  template <class X, class Y, class L, class H, class O> void add_gradient(X x, Y x_start, L law, H anchor, O out) {
    laws::surface_kernels::add_gradient(
        x, x_start, own, used, weights, triangles, areas, law, View<S, 1>(limit.data(), count), lag.triangles(), frames(),
        lag.directions(), anchor, now.gaps(), added_pressures(), now.numbers(), now.triangles(), now.weights(), now.directions(),
        now.shares(), View<S, 2>(force.data(), count, 3), View<S, 1>(load.data(), count), out);
  }
  // Elastic slip before it slides.
  template <class X, class Y, class H> Vec<S, 3> slip(X x, Y x_start, H anchor, int s) {
    return laws::surface_kernels::_elastic_slip(x, x_start, own, used, weights, triangles, lag.triangles(), frames(),
                                                lag.directions(), anchor, s)
        .a0;
  }
};

class Surface {
 public:
  Surface(const Record &record, int which)
      : r_(record), first_sample_(r_.surface_sample_start[which]), first_triangle_(r_.surface_triangle_start[which]),
        samples_(r_.surface_sample_start[which + 1] - first_sample_),
        triangles_(r_.surface_triangle_start[which + 1] - first_triangle_), corners_(int(r_.surface_corners)),
        margin_(r_.surface_margin[which]), law_(r_.surface_law + 8 * which, r_.surface_law + 8 * which + 8),
        d_law_(r_.d_surface_law + 8 * which * r_.columns), added_(r_, r_.contacts + which),
        step_({own(), samples_, corners_}, {r_.surface_used + first_sample_, samples_}, {weights(), samples_, corners_},
              {triangle(0), triangles_, 3}, {r_.surface_border + 6 * first_triangle_, triangles_, 6},
              {r_.surface_area + first_sample_, samples_}),
        candidates_(Primitives(own(), weights(), samples_, corners_), Primitives(triangle(0), nullptr, triangles_, 3), false,
                    [this](const double *x, int s, int t) { return distance(x, s, t); }) {
    held.resize(samples_, r_.columns);
    first_.assign(samples_ + 1, 0);
    normals_.assign(3 * r_.nodes, 0.0);
  }
  Surface(const Surface &) = delete;

  Held held;

  void guard(bool on) {
    set_guard(law_.data(), on);
    seen_.clear();
  }

  // Look for candidates on the way from `x` to `towards`; true when the coupled nodes changed.
  bool prepare(const double *x, const double *towards, bool more) {
    const auto changed = candidates_.search(x, towards, 3 * r_.nodes, law_[OFFSET] + law_[REACH], margin_, more);
    if (changed.inner) {
      const Keys &keys = candidates_.inner();
      near_.clear();
      first_.assign(samples_ + 1, 0);
      for (int64_t key : keys) {
        near_.push_back(candidates_.second(key));
        ++first_[candidates_.first(key) + 1];
      }
      for (int s = 0; s < samples_; ++s) first_[s + 1] += first_[s];
      side_.assign(near_.size(), 1.0);
    }
    return changed.outer;
  }
  void recouple(const double *x, const double *towards) { candidates_.recouple(x, towards); }
  bool outran(const double *x) const { return candidates_.outran(x); }

  // Pairs of the samples' nodes and of the corners of all triangles in the wider search, and of the corners of triangles
  // around one node, which may share in a gap.
  void couple(std::vector<PairTable::Pair> &pairs) const {
    std::set<int> near, members;
    for (int64_t key : candidates_.coupled()) {
      const int s = candidates_.first(key), t = candidates_.second(key);
      near.insert(t);
      members.insert(s);
      for (int a = 0; a < corners_; ++a)
        for (int k = 0; k < 3; ++k) pairs.push_back({own()[s * corners_ + a], triangle(t)[k]});
    }
    for (int s : members)
      for (int a = 0; a < corners_; ++a)
        for (int b = a; b < corners_; ++b) pairs.push_back({own()[s * corners_ + a], own()[s * corners_ + b]});
    std::vector<std::vector<int>> around(near.empty() ? 0 : r_.nodes);
    for (int t : near)
      for (int k = 0; k < 3; ++k)
        for (int m = 0; m < 3; ++m) around[triangle(t)[k]].push_back(triangle(t)[m]);
    for (auto &star : around) {
      std::sort(star.begin(), star.end());
      star.erase(std::unique(star.begin(), star.end()), star.end());
      for (std::size_t a = 0; a < star.size(); ++a)
        for (std::size_t b = a; b < star.size(); ++b) pairs.push_back({star[a], star[b]});
    }
  }

  void begin(const double *x_start) {
    x_start_ = x_start;
    seen_.clear();
    auto &limit = step_.limit;
    std::fill(limit.begin(), limit.end(), 0.0);
    std::fill(step_.load.begin(), step_.load.end(), 0.0);
    if (near_.empty()) {
      std::fill(step_.now.gap.begin(), step_.now.gap.end(), nowhere);
      return;
    }
    laws::surface_geometry::sides(rows(x_start), step_.own, step_.used, step_.weights, step_.triangles, first(), near(),
                                  View<double, 2>(normals_.data(), r_.nodes, 3), View<double, 1>(side_.data(), near_.size()));
    step_.measure(step_.lag, rows(x_start), first(), near(), normals(), side(), law());
    step_.make_frames(rows(x_start));
    for (int s = 0; s < samples_; ++s)
      if (step_.lag.number[s] > 0) limit[s] = added_.bound(law_[MU], held.load[s], step_.areas[s], held.speed[s], 0);
  }

  void add_energy(const double *x, double *out) {
    if (!look(x)) return;
    laws::surface_kernels::add_energy(rows(x), rows(x_start_), step_.own, step_.used, step_.weights, step_.triangles,
                                      step_.areas, law(), limits(), step_.lag.triangles(), step_.frames(),
                                      step_.lag.directions(), anchor(), step_.now.gaps(), step_.added_pressures(),
                                      View<double, 1>(out, 1));
  }
  void add_gradient(const double *x, double *out) {
    if (look(x)) step_.add_gradient(rows(x), rows(x_start_), law(), anchor(), View<double, 2>(out, r_.nodes, 3));
  }
  void add_hessian(const double *x, bool exact, PairTable &table) {
    if (!look(x)) return;
    auto &now = step_.now;
    const int participants = corners_ + 3 * now.most, with[1] = {exact};
    slopes_.resize(3 * participants * (now.most + 2));
    double second[16 * 9];
    laws::surface_kernels::add_hessian(
        rows(x), rows(x_start_), step_.own, step_.used, step_.weights, step_.triangles, step_.areas, law(), limits(),
        step_.lag.triangles(), step_.frames(), step_.lag.directions(), anchor(), now.gaps(), step_.added_pressures(), now.numbers(),
        now.triangles(), now.weights(), now.directions(), now.shares(), now.kinds(), now.signs(),
        View<const int, 1>(with, 1), table.start(), table.column(), table.place(),
        View<double, 3>(slopes_.data(), now.most + 2, participants, 3), View<double, 3>(second, 16, 3, 3), table.values());
  }

  double free_way(const double *x, const double *move, double keep) const {
    double way = 1.0;
    if (!near_.empty())
      laws::surface_geometry::free_way(rows(x), rows(move), step_.own, step_.used, step_.weights, step_.triangles, first(),
                                       near(), law(), View<const double, 1>(&keep, 1), View<double, 1>(&way, 1));
    return way;
  }

  // Memory after the step that ended at `x`, from forces that were evaluated last.
  void end(const double *x, double dt) {
    Held after;
    after.resize(samples_, 0);
    const bool any = look(x);
    for (int s = 0; any && s < samples_; ++s) {
      if (!(step_.load[s] > 0.0)) continue;
      const Vec3 kept = kept_slip(step_.slip(rows(x), rows(x_start_), anchor(), s), step_.limit[s], spring(s), dt, after.speed[s]);
      std::copy(kept.a, kept.a + 3, &after.anchor[3 * s]);
      after.load[s] = step_.load[s];
    }
    held.anchor.swap(after.anchor);
    held.load.swap(after.load);
    held.speed.swap(after.speed);
  }

  // What forces change by where positions at the end are held, into (nodes, 3, columns).
  void add_columns(const double *x, const double *dx_start, double *out) {
    if (!look(x)) return;
    for (int s = 0; s < samples_; ++s)
      if (acts(s))
        for (int first = 0; first < r_.columns; first += lanes) {
          One<InColumns> one(*this, s, x, {*this, s, first, dx_start, nullptr});
          for (std::size_t k = 0; k < one.nodes.size(); ++k)
            scatter(&one.out[3 * k], 3, out + 3 * one.nodes[k] * r_.columns, r_.columns, first);
        }
  }
  // Derivatives of the memory after the step; before `end`.
  void end_columns(const double *x, const double *dx_start, const double *dx, double dt) {
    Held after;
    after.resize(samples_, r_.columns);
    const bool any = look(x);
    for (int s = 0; any && s < samples_; ++s)
      if (step_.load[s] > 0.0)
        for (int first = 0; first < r_.columns; first += lanes) {
          One<InColumns> one(*this, s, x, {*this, s, first, dx_start, dx});
          Lanes speed;
          const Vec<Lanes, 3> kept = one.slide(dt, speed);
          scatter(kept.a, 3, &after.d_anchor[3 * s * r_.columns], r_.columns, first);
          scatter(&one.step.load[0], 1, &after.d_load[s * r_.columns], r_.columns, first);
          scatter(&speed, 1, &after.d_speed[s * r_.columns], r_.columns, first);
        }
    held.d_anchor.swap(after.d_anchor);
    held.d_load.swap(after.d_load);
    held.d_speed.swap(after.d_speed);
  }

  // Whether any sample touches or rubs, at the last gradient.
  bool acts() const {
    for (int s = 0; s < samples_; ++s)
      if (acts(s)) return true;
    return false;
  }

  // Loaded samples and the smallest gap [m], at the last gradient.
  std::pair<int64_t, double> report() const {
    int64_t loaded = 0;
    double smallest = nowhere;
    for (int s = 0; s < samples_; ++s) {
      loaded += step_.load[s] > 0.0;
      smallest = std::min(smallest, step_.now.gap[s]);
    }
    return {loaded, smallest};
  }

 private:
  template <class> friend struct Pull;
  template <class> friend struct PullPoints;

  // Numbers of one sample with their derivatives in some columns; dx: of the positions at the end, null where held.
  struct InColumns {
    using S = Lanes;
    using A = double;
    const Surface &of;
    int s, first;
    const double *dx_start, *dx;
    Lanes start(std::size_t k) const { return seeded(of.x_start_[k], dx_start + k * of.r_.columns + first); }
    Lanes end(std::size_t k, double at) const { return dx ? seeded(at, dx + k * of.r_.columns + first) : Lanes(at); }
    Lanes law(int k) const { return seeded(of.law_[k], of.d_law_ + k * of.r_.columns + first); }
    Lanes anchor(int i) const { return some(of.held.anchor, of.held.d_anchor, 3 * s + i); }
    double measured(double at) const { return at; }
    Lanes load() const { return some(of.held.load, of.held.d_load, s); }
    Lanes speed() const { return some(of.held.speed, of.held.d_speed, s); }
    Lanes some(const std::vector<double> &v, const std::vector<double> &d, int k) const {
      return seeded(v[k], &d[k * of.r_.columns + first]);
    }
  };

  // One sample with what it meets, of numbers with derivatives: forces on its nodes, and its load.
  template <class Given> struct One {
    using S = typename Given::S;
    using A = typename Given::A;
    const Surface &of;
    int s;
    std::vector<int> own, triangles, border, nodes;
    int used, corners;
    A area;
    std::vector<S> x, x_start, out;
    S law[8], anchor[3];
    SampleStep<S, A> step;

    One(const Surface &surface, int sample, const double *at, const Given &given)
        : of(surface), s(sample), nodes(members()), used(of.step_.used[s]), corners(of.corners_), area(given.measured(of.step_.areas[s])),
          step({own.data(), 1, corners}, {&used, 1}, {of.weights() + s * corners, 1, corners},
               {triangles.data(), triangles.size() / 3, 3}, {border.data(), triangles.size() / 3, 6}, {&area, 1}) {
      for (int node : nodes)
        for (int i = 0; i < 3; ++i) {
          const std::size_t k = 3 * std::size_t(node) + i;
          x_start.push_back(given.start(k));
          x.push_back(given.end(k, at[k]));
        }
      for (int k = 0; k < 8; ++k) law[k] = given.law(k);
      for (int i = 0; i < 3; ++i) anchor[i] = given.anchor(i);
      // Candidates: those that share in the gap now, the nearest first, then the one that was nearest at the start.
      const int now = of.step_.now.number[s];
      std::vector<int> near(now + 1);
      for (int k = 0; k <= now; ++k) near[k] = k;
      const std::vector<double> nothing(3 * nodes.size(), 0.0), side(now + 1, 1.0);
      const View<const double, 2> normals(nothing.data(), nodes.size(), 3);
      const View<const double, 1> sides(side.data(), side.size());
      const View<const int, 1> all(near.data(), near.size());
      const int here[2] = {0, now}, before[2] = {now, now + 1};
      step.measure(step.lag, starts(), View<const int, 1>(before, 2), all, normals, sides, numbers());
      step.measure(step.now, places(), View<const int, 1>(here, 2), all, normals, sides, numbers());
      step.make_frames(starts());
      if (of.step_.limit[s] > 0.0)
        step.limit[0] = of.added_.bound(law[MU], given.load(), area, given.speed(), given.first);
      if (value(step.now.gap[0]) < of.law_[REACH]) step.added[1] = of.added_.pressure(step.now.gap[0], 1.0, given.first);
      out.assign(3 * nodes.size(), S(0.0));
      step.add_gradient(places(), starts(), numbers(), remembered(), View<S, 2>(out.data(), nodes.size(), 3));
    }

    Vec<S, 3> slide(double dt, S &speed) {
      return kept_slip(step.slip(places(), starts(), remembered(), 0), step.limit[0], S(law[STIFFNESS] * area), dt, speed);
    }

   private:
    View<S, 2> places() { return {x.data(), nodes.size(), 3}; }
    View<S, 2> starts() { return {x_start.data(), nodes.size(), 3}; }
    View<S, 1> numbers() { return {law, 8}; }
    View<S, 2> remembered() { return {anchor, 1, 3}; }

    // Own nodes and the corners of the triangles, each once, and the tables in their numbers.
    std::vector<int> members() {
      std::vector<int> found;
      auto number = [&](int node) {
        const int at = int(std::find(found.begin(), found.end(), node) - found.begin());
        if (at == int(found.size())) found.push_back(node);
        return at;
      };
      for (int a = 0; a < of.corners_; ++a) own.push_back(number(of.own()[s * of.corners_ + a]));
      const auto &now = of.step_.now;
      for (int k = 0; k <= now.number[s]; ++k) {
        const int t = k < now.number[s] ? now.triangle[now.most * s + k] : of.step_.lag.triangle[now.most * s];
        for (int j = 0; j < 3; ++j) triangles.push_back(number(of.triangle(t)[j]));
        for (int j = 0; j < 6; ++j) border.push_back(of.step_.border(t, j));
      }
      return found;
    }
  };

  const int32_t *own() const { return r_.surface_node + first_sample_ * corners_; }
  const double *weights() const { return r_.surface_weight + first_sample_ * corners_; }
  const int32_t *triangle(int t) const { return r_.surface_triangle + 3 * (first_triangle_ + t); }
  double spring(int s) const { return law_[STIFFNESS] * step_.areas[s]; }
  bool acts(int s) const { return step_.limit[s] > 0.0 || step_.now.gap[s] < law_[REACH]; }

  View<const double, 2> rows(const double *x) const { return {x, r_.nodes, 3}; }
  View<const int, 1> first() const { return {first_.data(), first_.size()}; }
  View<const int, 1> near() const { return {near_.data(), near_.size()}; }
  View<const double, 2> normals() const { return {normals_.data(), r_.nodes, 3}; }
  View<const double, 1> side() const { return {side_.data(), side_.size()}; }
  View<const double, 1> law() const { return {law_.data(), 8}; }
  View<const double, 1> limits() const { return {step_.limit.data(), samples_}; }
  View<const double, 2> anchor() const { return {held.anchor.data(), samples_, 3}; }

  double distance(const double *x, int s, int t) const {
    const Vec3 p = laws::surface_geometry::sample_at(rows(x), step_.own, step_.used, step_.weights, s);
    return laws::surface_geometry::closest_on(rows(x), p, step_.triangles, t).a2.norm();
  }

  // Bring the gaps up to date with the positions; false when there is nothing to touch.
  bool look(const double *x) {
    if (near_.empty()) return false;
    if (seen_.empty() || !std::equal(seen_.begin(), seen_.end(), x)) {
      step_.measure(step_.now, rows(x), first(), near(), normals(), side(), law());
      seen_.assign(x, x + 3 * r_.nodes);
      for (int s = 0; added_.presses() && s < samples_; ++s) {
        const double gap = step_.now.gap[s];
        const auto at = gap < law_[REACH] ? added_.normal(gap, 1.0) : AddedLaws::Normal{};
        step_.added[3 * s] = at.energy;
        step_.added[3 * s + 1] = at.pressure;
        step_.added[3 * s + 2] = at.slope;
      }
    }
    return true;
  }

  const Record &r_;
  int64_t first_sample_, first_triangle_;
  int samples_, triangles_, corners_;
  double margin_;
  std::vector<double> law_;
  const double *d_law_, *x_start_ = nullptr;
  AddedLaws added_;
  SampleStep<double> step_;
  Candidates candidates_;
  std::vector<int> first_, near_;
  std::vector<double> side_, normals_, seen_, slopes_;
};

}  // namespace thinshell
