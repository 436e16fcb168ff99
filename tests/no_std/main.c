/* Links the engine into a C program and checks that both models pull a parked vehicle onto its true place. */
#include <stdint.h>
#include <stdio.h>

double gnssins_parked_ned(uint32_t seconds);
double gnssins_parked_ecef(uint32_t seconds);

int main(void)
{
    double ned = gnssins_parked_ned(60), ecef = gnssins_parked_ecef(60);
    int ok = ned >= 0.0 && ned < 0.05 && ecef >= 0.0 && ecef < 0.05;
    printf("no_std engine, 60 s parked, position error: NED %.1e m, ECEF %.1e m: %s\n", ned, ecef,
           ok ? "ok" : "FAILED");
    return !ok;
}
