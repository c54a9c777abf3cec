// Colour maps as tables of 256 colours.
// Source: A. Mikhailov, "Turbo, An Improved Rainbow Colormap", 2019 (polynomials); M. Zucker's fit of viridis (CC0).

export const COLOUR_MAPS = ["turbo", "viridis", "grey"] as const;
export type ColourMap = (typeof COLOUR_MAPS)[number];

export const MAP_SIZE = 256;

/** Coefficients of red, green and blue, of x⁰ first. */
const POLYNOMIALS: Readonly<Record<ColourMap, readonly (readonly number[])[]>> = {
  turbo: [
    [0.13572138, 4.6153926, -42.66032258, 132.13108234, -152.94239396, 59.28637943],
    [0.09140261, 2.19418839, 4.84296658, -14.18503333, 4.27729857, 2.82956604],
    [0.1066733, 12.64194608, -60.58204836, 110.36276771, -89.90310912, 27.34824973],
  ],
  viridis: [
    [0.2777273272, 0.1050930431, -0.3308618287, -4.6342304985, 6.2282699363, 4.7763849977, -5.4354558559],
    [0.0054073445, 1.4046135299, 0.2148475595, -5.799100973, 14.1799333668, -13.7451453777, 4.6458526122],
    [0.3340998053, 1.3845901626, 0.095095163, -19.332440956, 56.6905526007, -65.3530326334, 26.312435249],
  ],
  grey: [[0.1, 0.85], [0.1, 0.85], [0.1, 0.85]],
};

/** Returns red, green, blue and alpha of each colour, from 0 to 255, the colour of the least value first. */
export function colourTable(map: ColourMap): Uint8Array<ArrayBuffer> {
  const table = new Uint8Array(4 * MAP_SIZE);
  for (let place = 0; place < MAP_SIZE; place += 1) {
    const x = place / (MAP_SIZE - 1);
    POLYNOMIALS[map].forEach((coefficients, channel) => {
      const share = coefficients.reduceRight((sum, coefficient) => sum * x + coefficient, 0);
      table[4 * place + channel] = Math.round(255 * Math.min(1, Math.max(0, share)));
    });
    table[4 * place + 3] = 255;
  }
  return table;
}
