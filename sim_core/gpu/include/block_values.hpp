// Vectors of the searches in a thread block: places in an arena, with the functions of sim_core/core/include/vectors.hpp.
#pragma once

#include "team.hpp"

namespace thinshell {

// Room for `slots` vectors of up to `room` numbers. Every thread keeps the same account of which are taken.
class Arena {
 public:
  Arena(const Team &team, double *data, int room, int slots) : team(team), data_(data), room_(room), slots_(slots) {}

  // The lowest place that is free; all are taken where a search keeps too many vectors: `overflow`.
  THINSHELL_APART int take() {
    for (int w = 0; 32 * w < slots_; ++w)
      if (~taken_[w]) {
        const int s = 32 * w + lowest(~taken_[w]);
        if (s >= slots_) break;
        taken_[w] |= 1u << (s % 32);
        return s;
      }
    overflow = true;
    return slots_ - 1;
  }
  void give(int slot) { taken_[slot / 32] &= ~(1u << (slot % 32)); }
  double *at(int slot) const { return data_ + (long long)(slot) * room_; }

  static constexpr int most = 128;
  const Team &team;
  bool overflow = false;

 private:
  static int lowest(unsigned bits) {
#ifdef __CUDACC_RTC__
    return __ffs(bits) - 1;
#else
    return __builtin_ctz(bits);
#endif
  }
  double *data_;
  int room_, slots_;
  unsigned taken_[most / 32] = {};
};

class BlockValues {
 public:
  BlockValues() = default;
  BlockValues(Arena &arena, int size) { make(&arena, size); }
  THINSHELL_APART BlockValues(Arena &arena, int size, double value) : BlockValues(arena, size) {
    arena.team.each(size, [&](int k) { data()[k] = value; });
  }
  BlockValues(const BlockValues &other) { *this = other; }
  ~BlockValues() { clear(); }
  THINSHELL_APART BlockValues &operator=(const BlockValues &other) {
    if (this == &other) return *this;
    if (other.empty()) {
      clear();
      return *this;
    }
    if (size_ != other.size_) {
      clear();
      make(other.arena_, other.size_);
    }
    double *to = data();
    const double *from = other.data();
    team().each(size_, [&](int k) { to[k] = from[k]; });
    return *this;
  }
  void clear() {
    if (size_) arena_->give(slot_);
    size_ = 0;
  }
  bool empty() const { return size_ == 0; }
  int size() const { return size_; }
  double *data() { return arena_->at(slot_); }
  const double *data() const { return arena_->at(slot_); }
  double operator[](int k) const { return data()[k]; }
  const Team &team() const { return arena_->team; }
  void swap(BlockValues &other) {
    const int slot = slot_;
    slot_ = other.slot_;
    other.slot_ = slot;
  }

 private:
  void make(Arena *arena, int size) {
    arena_ = arena;
    slot_ = arena->take();
    size_ = size;
  }

  Arena *arena_ = nullptr;
  int slot_ = 0, size_ = 0;
};

THINSHELL_APART inline double dot(const BlockValues &a, const BlockValues &b) {
  const double *p = a.data(), *q = b.data();
  return a.team().sum(a.size(), [&](int k) { return p[k] * q[k]; });
}
THINSHELL_APART inline double largest(const BlockValues &v) {
  const double *p = v.data();
  return v.empty() ? 0.0 : v.team().most(v.size(), [&](int k) { return abs(p[k]); });
}
THINSHELL_APART inline void scale(BlockValues &v, double by) {
  double *p = v.data();
  v.team().each(v.size(), [&](int k) { p[k] *= by; });
}
THINSHELL_APART inline void add_scaled(BlockValues &to, double by, const BlockValues &of) {
  double *p = to.data();
  const double *q = of.data();
  to.team().each(to.size(), [&](int k) { p[k] += by * q[k]; });
}
THINSHELL_APART inline void set_slope(BlockValues &out, const BlockValues &a, const BlockValues &b, double over) {
  double *to = out.data();
  const double *p = a.data(), *q = b.data();
  out.team().each(out.size(), [&](int k) { to[k] = (p[k] - q[k]) / over; });
}

// As of vectors.hpp; of more than `most` the last ones are left out, and the tangent is renewed when it serves no more.
class BlockCorrections {
 public:
  static constexpr int most = 16;
  THINSHELL_APART void clear() {
#pragma unroll 1
    for (int k = 0; k < count_; ++k) {
      change_[k].clear();
      step_[k].clear();
    }
    count_ = 0;
  }
  int count() const { return count_; }
  const BlockValues &change(int k) const { return change_[k]; }
  const BlockValues &step(int k) const { return step_[k]; }
  THINSHELL_APART void push(const BlockValues &change, const BlockValues &step) {
    if (count_ == most) return;
    change_[count_] = change;
    step_[count_++] = step;
  }

 private:
  BlockValues change_[most], step_[most];
  int count_ = 0;
};

}  // namespace thinshell
