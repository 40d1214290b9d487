/* The dynamics network of `study.models.networks.dynamics`, unrolled over a whole horizon, forwards
   and backwards. `unroll.py` has the equations.

   The trajectories of a batch are independent. So a block of ROWS trajectories runs through the
   whole horizon at once, and its state and the weights stay in the nearest caches. Each step is a
   few matrix products of a few rows (`product`). The pointwise operations follow while the result
   is still in the cache. The gradients of the weights are sums over steps and rows; the caller
   computes them from `tape` and `gradients`.

   Arrays are float32 in row-major order. The leading axis M is that of independent networks, each
   with its own weights. A row adds its products in the same order for every batch size, so a
   forecast does not depend on the other forecasts of the batch. */

#include "vectors.h"
#include "layout.h"
#include "pointwise.h"

/* The forward pass of the blocks first … last - 1. There are M · ceil(B / ROWS) blocks.

   Writes states [M, B, T, D]. Writes tops y_L [M, B, T, W] and, for the backward pass, tape
   [M, B, T, `tape.size`], unless they are null. */
void forward(
    long first, long last, const Sizes *sizes, const Weights *weights, const Inputs *inputs,
    float *states, float *tops, float *tape)
{
    const Layout n = layout(sizes);
    const long batch = sizes->batch, steps = sizes->steps, blocks = (batch + ROWS - 1) / ROWS;
    const long D = n.D, P = n.P, H = n.H, L = n.L, F = n.F, O = n.O, W = n.W;
    const int has_mix = H && P;
    const float bound = sizes->bound;
    const long HH = padded(H), WW = padded(W), DD = padded(D);
    const long sums_row = padded(O + H) + WIDE, hp_row = padded(H + P) + WIDE, f_row = padded(F);
    float *by_state = zeros(F * padded(O)), *by_stem = zeros(P * padded(3 * H));
    float *by_hidden = zeros(H * padded(3 * H)), *by_mix = zeros((H + P) * padded(P));
    float *by_layer = zeros(L * W * WW), *by_output = zeros(W * DD);
    float *by_noise = zeros(W * DD), *by_log_std = zeros(W * DD);
    float *f = zeros(ROWS * f_row), *sums = zeros(ROWS * sums_row), *hp = zeros(ROWS * hp_row);
    float *h = zeros(ROWS * HH), *gates = zeros(ROWS * 4 * HH), *top = zeros(ROWS * WW);
    float *a = zeros(ROWS * WW), *s = zeros(ROWS * DD), *w = zeros(ROWS * DD);
    float *previous = zeros(ROWS * DD), *frames = zeros(ROWS * 3);
    long packed = -1;
    for (long index = first; index < last; index++) {
        const long m = index / blocks, row = index % blocks * ROWS;
        const long rows = batch - row < ROWS ? batch - row : ROWS;
        if (m != packed) {
            pack(weights->state + m * F * O, F, O, O, 1, by_state);
            if (has_mix) pack(weights->gates + m * P * 3 * H, P, 3 * H, 3 * H, 1, by_stem);
            if (H) pack(weights->hidden + m * H * 3 * H, H, 3 * H, 3 * H, 1, by_hidden);
            if (has_mix) pack(weights->mix + m * (H + P) * P, H + P, P, P, 1, by_mix);
            for (long i = 0; i < L; i++)
                pack(weights->layers + (m * L + i) * W * W, W, W, W, 1, by_layer + i * W * WW);
            if (D) pack(weights->output + m * W * D, W, D, D, 1, by_output);
            if (inputs->gain) pack(weights->noise_output + m * W * D, W, D, D, 1, by_noise);
            if (inputs->noise) pack(weights->log_std + m * W * D, W, D, D, 1, by_log_std);
            packed = m;
        }
        for (long i = 0; i < rows; i++) {
            const long r = m * batch + row + i;
            copy(H, inputs->hidden + r * H, h + i * HH);
            copy(D, inputs->state + r * D, s + i * DD);
        }
        for (long t = 0; t < steps; t++) {
            for (long i = 0; i < rows; i++) {
                const long at = (m * batch + row + i) * steps + t;
                float *row_sums = sums + i * sums_row;
                if (n.Q) axis(weights, s + i * DD, frames + i * 3);
                features(&n, weights, s + i * DD, frames + i * 3, f + i * f_row);
                copy(O, inputs->terms + at * O, row_sums);
                if (H) copy(H, weights->hidden_bias + m * H, row_sums + O);
                if (tape) copy(H, h + i * HH, tape + at * n.tape.size + n.tape.before);
            }
            product(rows, F, O, f, f_row, by_state, sums, sums_row);
            for (long i = 0; i < rows; i++) {
                float *u = sums + i * sums_row + D, *p = hp + i * hp_row + H;
                for (long j = 0; j < P; j += LANES)
                    store(load(u + j) * silu(load(u + P + j)), p + j);
            }
            if (H) {
                if (P) product(rows, P, 3 * H, hp + H, hp_row, by_stem, sums + D + 2 * P, sums_row);
                product(rows, H, 3 * H, h, HH, by_hidden, sums + D + 2 * P + H, sums_row);
            }
            for (long i = 0; i < rows; i++) {
                float *row_hp = hp + i * hp_row;
                float *row_gates = gates + i * 4 * HH, *row_top = top + i * WW;
                if (H) advance(H, sums + i * sums_row + D + 2 * P, row_gates, HH, h + i * HH);
                copy(H, h + i * HH, row_hp);
                copy(W, P ? row_hp + H : row_hp, row_top);
                if (has_mix)
                    for (long j = 0; j < P; j++) row_top[j] += weights->mix_bias[m * P + j];
            }
            if (has_mix) product(rows, H + P, P, hp, hp_row, by_mix, top, WW);
            for (long i = 0; tape && i < rows; i++) {
                float *step = tape + ((m * batch + row + i) * steps + t) * n.tape.size;
                copy(F, f + i * f_row, step);
                copy(H + P, hp + i * hp_row, step + n.tape.after);
                copy(2 * P, sums + i * sums_row + D, step + n.tape.u);
                for (long k = 0; k < 4; k++)
                    copy(H, gates + (4 * i + k) * HH, step + n.tape.gates + k * H);
                copy(W, top + i * WW, step + n.tape.top);
            }
            for (long layer = 0; layer < L; layer++) {
                for (long i = 0; i < rows; i++)
                    copy(W, weights->layers_bias + (m * L + layer) * W, a + i * WW);
                product(rows, W, W, top, WW, by_layer + layer * W * WW, a, WW);
                for (long i = 0; i < rows; i++) {
                    float *row_top = top + i * WW, *row_a = a + i * WW;
                    for (long j = 0; j < W; j += LANES)
                        store(load(row_top + j) + silu(load(row_a + j)), row_top + j);
                    if (!tape) continue;
                    float *step = tape + ((m * batch + row + i) * steps + t) * n.tape.size;
                    copy(W, row_a, step + n.tape.sums + layer * W);
                    copy(W, row_top, step + n.tape.top + (layer + 1) * W);
                }
            }
            for (long i = 0; i < rows; i++) {
                const long at = (m * batch + row + i) * steps + t;
                if (tops) copy(W, top + i * WW, tops + at * W);
                if (n.Q) copy(D, s + i * DD, previous + i * DD);
                copy(D, sums + i * sums_row, s + i * DD);
                if (inputs->noise) copy(D, weights->log_std_bias + m * D, w + i * DD);
                const float *gain = inputs->gain ? inputs->gain + at * W : 0;
                for (long j = 0; gain && j < W; j++) a[i * WW + j] = top[i * WW + j] * gain[j];
            }
            if (!D) continue;
            product(rows, W, DD, top, WW, by_output, s, DD);
            if (inputs->gain) product(rows, W, DD, a, WW, by_noise, s, DD);
            if (inputs->noise) product(rows, W, DD, top, WW, by_log_std, w, DD);
            for (long i = 0; i < rows; i++) {
                const long at = (m * batch + row + i) * steps + t;
                float *row_s = s + i * DD, *row_w = w + i * DD;
                for (long j = 0; inputs->noise && j < DD; j += LANES)
                    store(exponential(bound * hyperbolic_tangent(load(row_w + j) / bound)), row_w + j);
                for (long j = 0; inputs->noise && j < D; j++)
                    row_s[j] += row_w[j] * inputs->noise[at * D + j];
                if (n.Q) {
                    turn(&n, weights, frames + i * 3, 1, row_s);
                    if (tape) {
                        copy(3, frames + i * 3, tape + at * n.tape.size + n.tape.frame);
                        copy(D, row_s, tape + at * n.tape.size + n.tape.change);
                    }
                    for (long j = 0; j < D; j++) row_s[j] += previous[i * DD + j];
                }
                for (long j = 0; j < D; j++) {
                    row_s[j] = row_s[j] > weights->highest[j] ? weights->highest[j] : row_s[j];
                    row_s[j] = row_s[j] < weights->lowest[j] ? weights->lowest[j] : row_s[j];
                }
                copy(D, row_s, states + at * D);
            }
        }
    }
    float *all[] = {by_state, by_stem, by_hidden, by_mix, by_layer, by_output, by_noise, by_log_std,
                    f, sums, hp, h, gates, top, a, s, w, previous, frames};
    for (unsigned i = 0; i < sizeof all / sizeof *all; i++) free(all[i]);
}

/* The backward pass, from the last step to the first. Sizes and blocks are those of `forward`.

   Reads states and tape, and the gradients of the results, grad_states [M, B, T, D] and grad_tops
   [M, B, T, W]; either may be null. Writes gradients [M, B, T, `gradients.size`], grad_gain
   [M, B, T, W] where there are gains, grad_state [M, B, D] and grad_hidden [M, B, H]. */
void backward(
    long first, long last, const Sizes *sizes, const Weights *weights, const Inputs *inputs,
    const float *states, const float *tape, const float *grad_states, const float *grad_tops,
    float *gradients, float *grad_gain, float *grad_state, float *grad_hidden)
{
    const Layout n = layout(sizes);
    const long batch = sizes->batch, steps = sizes->steps, blocks = (batch + ROWS - 1) / ROWS;
    const long D = n.D, P = n.P, H = n.H, L = n.L, F = n.F, O = n.O, W = n.W;
    const int has_mix = H && P;
    const long HH = padded(H), WW = padded(W), DD = padded(D), FF = padded(F);
    const long hp_row = padded(H + P) + WIDE, g_row = padded(n.gradients.size) + WIDE;
    float *by_state = zeros(O * FF), *by_stem = zeros(3 * H * padded(P));
    float *by_hidden = zeros(3 * H * HH), *by_mix = zeros(P * padded(H + P));
    float *by_layer = zeros(L * W * WW), *by_output = zeros(D * WW), *by_noise = zeros(D * WW);
    float *g = zeros(ROWS * g_row), *hp = zeros(ROWS * hp_row), *grad_f = zeros(ROWS * FF);
    float *grad_h = zeros(ROWS * HH), *grad_s = zeros(ROWS * DD), *top = zeros(ROWS * WW);
    float *q = zeros(ROWS * WW), *u = zeros(padded(P)), *v = zeros(padded(P));
    long packed = -1;
    for (long index = first; index < last; index++) {
        const long m = index / blocks, row = index % blocks * ROWS;
        const long rows = batch - row < ROWS ? batch - row : ROWS;
        if (m != packed) { /* transposes of the weights */
            pack(weights->state + m * F * O, O, F, 1, O, by_state);
            if (has_mix) pack(weights->gates + m * P * 3 * H, 3 * H, P, 1, 3 * H, by_stem);
            if (H) pack(weights->hidden + m * H * 3 * H, 3 * H, H, 1, 3 * H, by_hidden);
            if (has_mix) pack(weights->mix + m * (H + P) * P, P, H + P, 1, P, by_mix);
            for (long i = 0; i < L; i++)
                pack(weights->layers + (m * L + i) * W * W, W, W, 1, W, by_layer + i * W * WW);
            if (D) pack(weights->output + m * W * D, D, W, 1, D, by_output);
            if (inputs->gain) pack(weights->noise_output + m * W * D, D, W, 1, D, by_noise);
            packed = m;
        }
        memset(grad_h, 0, ROWS * HH * sizeof(float));
        memset(grad_s, 0, ROWS * DD * sizeof(float));
        for (long t = steps - 1; t >= 0; t--) {
            for (long i = 0; i < rows; i++) {
                const long at = (m * batch + row + i) * steps + t;
                float *row_s = grad_s + i * DD, *row_top = top + i * WW;
                memset(row_top, 0, WW * sizeof(float));
                if (grad_tops) copy(W, grad_tops + at * W, row_top);
                for (long j = 0; j < D; j++) {
                    const float s = states[at * D + j];
                    if (grad_states) row_s[j] += grad_states[at * D + j];
                    if (s <= weights->lowest[j] || s >= weights->highest[j]) row_s[j] = 0;
                }
                float *row_g = g + i * g_row;
                copy(D, row_s, row_g);
                if (n.Q) turn(&n, weights, tape + at * n.tape.size + n.tape.frame, -1, row_g);
            }
            if (D) product(rows, D, WW, g, g_row, by_output, top, WW);
            if (inputs->gain) {
                memset(q, 0, ROWS * WW * sizeof(float));
                product(rows, D, WW, g, g_row, by_noise, q, WW);
                for (long i = 0; i < rows; i++) {
                    const long at = (m * batch + row + i) * steps + t;
                    const float *step = tape + at * n.tape.size + n.tape.top + L * W;
                    for (long j = 0; j < W; j++) {
                        top[i * WW + j] += q[i * WW + j] * inputs->gain[at * W + j];
                        grad_gain[at * W + j] = q[i * WW + j] * step[j];
                    }
                }
            }
            for (long layer = L - 1; layer >= 0; layer--) {
                for (long i = 0; i < rows; i++) {
                    const long at = (m * batch + row + i) * steps + t;
                    const float *sums = tape + at * n.tape.size + n.tape.sums + layer * W;
                    float *into = q + i * WW;
                    copy(W, sums, into); /* a vector may reach past the end of the tape */
                    for (long j = 0; j < W; j += LANES)
                        store(load(top + i * WW + j) * silu_slope(load(into + j)), into + j);
                    copy(W, into, g + i * g_row + n.gradients.sums + layer * W);
                }
                product(rows, W, WW, g + n.gradients.sums + layer * W, g_row,
                        by_layer + layer * W * WW, top, WW);
            }
            memset(hp, 0, ROWS * hp_row * sizeof(float));
            for (long i = 0; i < rows; i++) {
                copy(W, top + i * WW, hp + i * hp_row + (P ? H : 0));
                if (has_mix) copy(P, top + i * WW, g + i * g_row + n.gradients.mix);
            }
            if (has_mix) product(rows, P, H + P, top, WW, by_mix, hp, hp_row);
            for (long i = 0; H && i < rows; i++) {
                const float *step = tape + ((m * batch + row + i) * steps + t) * n.tape.size;
                float *row_h = grad_h + i * HH;
                for (long j = 0; j < H; j++) row_h[j] += hp[i * hp_row + j];
                through_gates(H, step + n.tape.gates, step + n.tape.before, row_h,
                              g + i * g_row + n.gradients.gates);
            }
            if (H) {
                product(rows, 3 * H, H, g + n.gradients.gates + H, g_row, by_hidden, grad_h, HH);
                if (P)
                    product(rows, 3 * H, P, g + n.gradients.gates, g_row, by_stem, hp + H, hp_row);
            }
            for (long i = 0; P && i < rows; i++) {
                const float *step = tape + ((m * batch + row + i) * steps + t) * n.tape.size;
                copy(P, step + n.tape.u, u); /* a vector may reach past the end of the tape */
                copy(P, step + n.tape.v, v);
                const float *grad_p = hp + i * hp_row + H;
                float *grad_u = q + i * WW, *row_g = g + i * g_row + n.gradients.stem;
                for (long j = 0; j < P; j += LANES)
                    store(load(grad_p + j) * silu(load(v + j)), grad_u + j);
                copy(P, grad_u, row_g);
                for (long j = 0; j < P; j += LANES)
                    store(load(grad_p + j) * load(u + j) * silu_slope(load(v + j)), grad_u + j);
                copy(P, grad_u, row_g + P);
            }
            memset(grad_f, 0, ROWS * FF * sizeof(float));
            product(rows, O, F, g, g_row, by_state, grad_f, FF);
            for (long i = 0; i < rows; i++) {
                const long at = (m * batch + row + i) * steps + t;
                const float *step = tape + at * n.tape.size;
                through_features(&n, weights, sizes->decay, step, step + n.tape.frame,
                                 grad_f + i * FF, grad_s + i * DD);
                copy(n.gradients.size, g + i * g_row, gradients + at * n.gradients.size);
            }
        }
        for (long i = 0; i < rows; i++) {
            const long r = m * batch + row + i;
            copy(H, grad_h + i * HH, grad_hidden + r * H);
            copy(D, grad_s + i * DD, grad_state + r * D);
        }
    }
    float *all[] = {by_state, by_stem, by_hidden, by_mix, by_layer, by_output, by_noise, g, hp,
                    grad_f, grad_h, grad_s, top, q, u, v};
    for (unsigned i = 0; i < sizeof all / sizeof *all; i++) free(all[i]);
}
