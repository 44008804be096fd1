// Material laws on the way back (elements_pull.hpp).
#pragma once

#include "contact_pull.hpp"
#include "strain_laws.hpp"

namespace thinshell {

// Material laws of one kind of elements. `memory`: weights of what each remembers after the step, then before it.
template <int K> struct Pull<StrainLaws<K>> {
  std::vector<std::vector<double>> memory;

  Pull(StrainLaws<K> &laws, const Record &record) : l_(laws), r_(record) {
    for (auto &law : l_.laws_) memory.emplace_back(law.state.size(), 0.0);
  }
  std::vector<double> *of(int number) {
    for (std::size_t k = 0; k < memory.size(); ++k)
      if (l_.laws_[k].number == number) return &memory[k];
    return nullptr;
  }

  // Weights of the strains at the end by those of the memory (elements, K), added; `strain` as of StrainLaws.
  template <class F> void to_end(F &&strain, std::vector<double> &end) {
    for (std::size_t k = 0; k < memory.size(); ++k) {
      auto &law = l_.laws_[k];
      if (std::all_of(memory[k].begin(), memory[k].end(), [](double w) { return w == 0.0; })) continue;
      law.see(strain);
      for (int p = 0; p < law.count; ++p)
        along(law, p, nullptr, &memory[k][std::size_t(law.states) * p], K, [](int i, double *change) { change[i * lanes] = 1.0; },
              [&](int i, double w) { end[std::size_t(K) * law.element[p] + i] += w; });
    }
  }

  // Of the strains at the start and, by elements, at the end (elements, K), added, of the memory before the step, and of
  // numbers. `stress`: weights of the stresses times areas (elements, K).
  template <class F>
  void to_start(F &&strain, const std::vector<double> &stress, std::vector<double> &start, std::vector<double> &end,
                StepWeights &w) {
    for (std::size_t k = 0; k < memory.size(); ++k) {
      auto &law = l_.laws_[k];
      law.see(strain);
      law.exert();
      const int first_block = r_.material_block_start[law.number], last_block = r_.material_block_start[law.number + 1];
      std::vector<int> seen;  // of what a point sees
      for (int i = 0; i < law.inputs; ++i)
        if (w.by_elements || (i >= K && i < 2 * K) || (i >= law.first_state() && i < law.first_state() + law.states))
          seen.push_back(i);
      const int own_count = int(seen.size());
      std::vector<double> before(memory[k].size(), 0.0), row(law.inputs);
      for (int p = 0; p < law.count; ++p) {
        const double *own = &stress[std::size_t(K) * law.element[p]];
        const auto by = [&](int b) { return r_.d_material_row + r_.material_block_row[b] + std::size_t(law.inputs + 1) * p; };
        std::fill(row.begin(), row.end(), 0.0);
        along(
            law, p, own, &memory[k][std::size_t(law.states) * p], own_count + last_block - first_block,
            [&](int i, double *change) {
              if (i < own_count) change[seen[i] * lanes] = 1.0;
              for (int n = 0; i >= own_count && n < law.inputs; ++n) change[n * lanes] = by(first_block + i - own_count)[n];
            },
            [&](int i, double weight) {
              if (i < own_count)
                row[seen[i]] = weight;
              else
                w.numbers[r_.material_of[first_block + i - own_count]] += weight;
            });
        for (int i = 0; i < K; ++i) {
          start[std::size_t(K) * law.element[p] + i] += row[K + i];
          end[std::size_t(K) * law.element[p] + i] += row[i];
        }
        std::copy_n(&row[law.first_state()], law.states, &before[std::size_t(law.states) * p]);
        double work = 0.0;  // which grows with the area
        for (int i = 0; i < K; ++i) work += law.area[p] * law.out[(1 + K) * p + 1 + i] * own[i];
        for (int b = first_block; b < last_block; ++b) w.numbers[r_.material_of[b]] += by(b)[law.inputs] * work;
        if (!w.by_elements) continue;
        double *rows = &w.elements.material_row[r_.material_row_start[law.number] + std::size_t(law.inputs) * p];
        for (int i = 0; i < law.inputs; ++i) rows[i] += row[i];
        w.elements.material_area[r_.material_start[law.number] + p] += work;
      }
      memory[k].swap(before);
    }
  }

 private:
  // Derivatives of weighted stresses (null: none) and new internal variables of a point in `count` directions.
  // `direct(i, change)` writes one, every so many `lanes` a number; `give(i, derivative)` takes what is found.
  template <class Law, class D, class G>
  void along(Law &law, int p, const double *stress, const double *state, int count, D &&direct, G &&give) {
    bool stressed = false, remembered = false;
    for (int i = 0; stress && i < K; ++i) stressed = stressed || stress[i] != 0.0;
    for (int z = 0; z < law.states; ++z) remembered = remembered || state[z] != 0.0;
    if (!stressed && !remembered) return;
    change_.resize(law.changes());
    result_.resize(std::size_t(law.widest()) * lanes);
    for (int first = 0; first < count; first += lanes) {
      const int some = std::min(lanes, count - first);
      std::fill(change_.begin(), change_.end(), 0.0);
      for (int l = 0; l < some; ++l) direct(first + l, &change_[l]);
      double total[lanes] = {};
      auto sum = [&](int which, const double *weight, int rows, double by) {
        law.template function<PushFunction>(which)(1, law.row(p), change_.data(), result_.data());
        for (int i = 0; i < rows; ++i)
          for (int l = 0; l < some; ++l) total[l] += by * weight[i] * result_[lanes * i + l];
      };
      if (stressed) sum(3, stress, K, law.area[p]);
      if (remembered) sum(4, state, law.states, 1.0);
      for (int l = 0; l < some; ++l) give(first + l, total[l]);
    }
  }

  StrainLaws<K> &l_;
  const Record &r_;
  std::vector<double> change_, result_;
};

}  // namespace thinshell
