/** Decompressed chunks that requests share, by their offset in the file. Keeps at most `maxBytes` of them. */

export class ChunkCache {
  /** The least recently used one first. */
  private readonly chunks = new Map<number, Uint8Array>();
  private size = 0;

  constructor(private readonly maxBytes: number) {}

  /** What is in memory, in bytes. */
  get bytes(): number {
    return this.size;
  }

  /** Return the chunk at an offset; `load` reads and decompresses it where it is not in memory. */
  async get(at: number, load: () => Promise<Uint8Array>): Promise<Uint8Array> {
    const known = this.chunks.get(at);
    if (known !== undefined) {
      this.chunks.delete(at); // and put it back as the youngest
      this.chunks.set(at, known);
      return known;
    }
    const content = await load();
    this.add(at, content);
    return content;
  }

  private add(at: number, content: Uint8Array): void {
    if (content.length > this.maxBytes) return;
    this.size += content.length - (this.chunks.get(at)?.length ?? 0);
    this.chunks.set(at, content);
    for (const [oldest, { length }] of this.chunks) {
      if (this.size <= this.maxBytes) break;
      this.chunks.delete(oldest);
      this.size -= length;
    }
  }
}
