// The limit for everything that computes: chains of multiply-adds, each of which waits only for itself.
//
//     x = x factor + term, `steps` times, in 16 x CHAINS chains that begin at 0, 1, 2, ...
//
// The host passes 1 for factor and term, so that a chain counts its own steps. The compiler does not know these values,
// so it cannot leave out any step.
//
// result  16 floats per work-item: the sums over its chains, lane by lane
//
// One work-item per 16 x CHAINS chains: enough to cover the latency of a multiply-add.

#include "common/fma.clh"

#pragma OPENCL FP_CONTRACT OFF

kernel void multiply_add(const float factor, const float term, const uint steps, global float16 *restrict result)
{
    const float16 lane = (float16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
    float16 x[CHAINS];
#pragma unroll
    for (int c = 0; c < CHAINS; ++c)
        x[c] = lane + 16.0f * c;
    for (uint s = 0; s < steps; ++s) {
#pragma unroll
        for (int c = 0; c < CHAINS; ++c)
            x[c] = FMA(x[c], (float16)(factor), (float16)(term));
    }
    float16 sum = 0.0f;
#pragma unroll
    for (int c = 0; c < CHAINS; ++c)
        sum += x[c];
    result[get_global_id(0)] = sum;
}
