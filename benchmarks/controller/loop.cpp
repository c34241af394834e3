// A filter's step in a control loop of C++: no Python, nothing allocated while it runs.
//
//   loop SAMPLES FOUND PERIOD_US STEPS
//
// SAMPLES holds load_filter_sample after load_filter_sample, one a step, over and over; FOUND gets what the first pass
// over them found. A step is due every PERIOD_US microseconds (0: at once). Printed: quantiles of a step's time in
// microseconds, by the clock and by what the core spent on it.

#include <time.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <vector>

#include "load_filter.h"

static double now_us(clockid_t clock) {
  timespec t;
  clock_gettime(clock, &t);
  return 1e6 * t.tv_sec + 1e-3 * t.tv_nsec;
}

static void quantiles(const char *name, std::vector<double> &x) {
  std::sort(x.begin(), x.end());
  std::printf("%s %.3f %.3f %.3f\n", name, x[x.size() / 2], x[x.size() * 99 / 100], x.back());
}

int main(int count, char **arguments) {
  if (count != 5) return 2;
  std::vector<load_filter_sample> samples;
  load_filter_sample sample;
  std::FILE *file = std::fopen(arguments[1], "rb");
  if (!file) return 1;
  while (std::fread(&sample, sizeof sample, 1, file) == 1) samples.push_back(sample);
  std::fclose(file);
  const double period = std::atof(arguments[3]);
  const size_t steps = std::atoi(arguments[4]);
  std::vector<double> clock(steps), core(steps);
  std::vector<load_filter_found> found(samples.size());
  load_filter_state state = load_filter_start;
  load_filter_found last;
  timespec due;
  clock_gettime(CLOCK_MONOTONIC, &due);
  for (size_t k = 0; k < steps; ++k) {
    if (period > 0) {
      due.tv_nsec += static_cast<long>(1e3 * period);
      due.tv_sec += due.tv_nsec / 1000000000;
      due.tv_nsec %= 1000000000;
      clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, nullptr);
    }
    const double begin = now_us(CLOCK_MONOTONIC), spent = now_us(CLOCK_THREAD_CPUTIME_ID);
    load_filter(&state, &samples[k % samples.size()], &last);
    core[k] = now_us(CLOCK_THREAD_CPUTIME_ID) - spent;
    clock[k] = now_us(CLOCK_MONOTONIC) - begin;
    if (k < samples.size()) found[k] = last;
  }
  quantiles("clock", clock);
  quantiles("core", core);
  file = std::fopen(arguments[2], "wb");
  if (!file) return 1;
  std::fwrite(found.data(), sizeof found[0], std::min(steps, found.size()), file);
  return std::fclose(file);
}
